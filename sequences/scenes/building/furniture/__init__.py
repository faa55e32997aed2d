"""The furniture of buildings: every piece has its back to the wall y = 0, and begins at x = 0."""
