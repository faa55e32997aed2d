"""Errors and OOD model of a trained network, fitted on held-out images."""
