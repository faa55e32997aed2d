"""A hall whose ceiling repeats itself."""
