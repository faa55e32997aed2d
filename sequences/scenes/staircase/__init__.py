"""A stairwell of six floors, four of which look the same."""
