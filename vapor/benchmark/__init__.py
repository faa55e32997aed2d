"""Measurements of the library, by a command of their own: nothing outside of this folder imports it."""

PROGRAM = "vapor-benchmark"
"""The command."""
