"""Images with true poses that networks learn from and are judged by: read, scaled, and what they cover."""
