"""How a trained network errs, and what is familiar to it: both found on held-out images."""
