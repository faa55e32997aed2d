"""Experiments with many small trainings, each resumable run by run."""
