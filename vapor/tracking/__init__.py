"""Tracking methods over the posteriors of a sequence: the filter, its ablations and baselines, and how they step."""
