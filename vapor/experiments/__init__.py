"""Experiments of many small training runs, each of which goes on after an interruption."""
