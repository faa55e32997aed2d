"""Recorded and synthetic sequences: readers, writers, data sets and rendered scenes."""
