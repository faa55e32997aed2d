"""What files say, read within limits: text, JSON, YAML, arrays, and the names of other files."""
