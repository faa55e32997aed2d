"""Errors and familiarity of a trained network, fitted on held-out images."""
