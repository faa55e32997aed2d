"""Trials on synthetic sequences: their choice, the input of the methods, and the results."""
