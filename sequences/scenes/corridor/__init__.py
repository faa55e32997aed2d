"""Two floors alike, each a long corridor that repeats itself."""
