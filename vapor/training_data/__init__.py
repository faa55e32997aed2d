"""Images with true poses that networks learn from and are evaluated on: read, scaled, and checked."""
