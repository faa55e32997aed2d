"""How data sets of images with true poses lie on disk, a module a layout.

Each has `LOOKED_FOR`, a file it is recognised by, and `list_images(path)`, None where such are not there.
"""
