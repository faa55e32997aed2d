"""Trained models: their files, how their images err until they are calibrated, and those that ship."""
