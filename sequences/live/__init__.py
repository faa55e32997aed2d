"""A running robot: its topics, as raw messages like those of a recording."""
