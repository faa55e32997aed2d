"""Engines that run networks, numpy in and numpy out; and networks as ONNX files, for engines elsewhere."""
