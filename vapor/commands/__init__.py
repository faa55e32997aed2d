"""One module a command of `vapor-track`: its options, and what it prints."""
