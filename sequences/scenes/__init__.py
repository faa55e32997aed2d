"""The synthetic scenes: what stands in them, and how people and carts move through them."""
