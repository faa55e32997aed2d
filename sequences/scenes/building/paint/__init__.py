"""What the surfaces of a building look like."""
