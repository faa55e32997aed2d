"""Layouts of data sets of images with true poses: one module for each, and nothing else.

A new layout is one new file here: `sequences.datasets.layout` states its requirements.
"""
