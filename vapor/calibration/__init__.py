"""Errors and ood_model of a trained network, fitted on held-out images."""
