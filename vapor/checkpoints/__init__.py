"""Trained models: their files, their errors before calibration, and the shipped models."""
