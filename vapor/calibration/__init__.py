"""How a trained network errs, and what is familiar to it, found on held-out images."""
