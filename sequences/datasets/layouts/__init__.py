"""How data sets of images with true poses lie on disk, a module a layout and nothing else.

A new layout is one new file here: `sequences.datasets.layout` says what it has to have.
"""
