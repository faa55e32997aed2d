"""Engines: what runs a network in use, numpy in and numpy out; and networks as ONNX files, for engines elsewhere."""
