"""Localization of a robot while it moves: its topics in, poses, tf and diagnostics out."""
