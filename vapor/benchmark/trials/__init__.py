"""Trials on synthetic sequences: which there are, what the methods are given of each, and how well they did."""
