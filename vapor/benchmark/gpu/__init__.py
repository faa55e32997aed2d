"""What a GPU gives: the same results as a processor, and how fast; in stages that share a few minutes."""
