"""Regressors side by side: many small trainings, each of which goes on after an interruption."""
