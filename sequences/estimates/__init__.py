"""Pose estimates of others, as files of named or timed frames, in place of images."""
