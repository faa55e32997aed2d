"""Folders of results: whole or not there, told by a manifest, and only replaced by results."""
