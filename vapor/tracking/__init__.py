"""Tracking methods over the posteriors of a sequence: the filter, its ablations, and its baselines."""
