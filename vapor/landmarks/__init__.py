"""Landmarks: points of the place that training images show, by which a pose is found to centimetres."""
