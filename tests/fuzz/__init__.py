"""Damaged files by the thousand, for every reader: `make fuzz`, or `python -m tests.fuzz --help`."""
