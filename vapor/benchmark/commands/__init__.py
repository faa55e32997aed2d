"""One module a command of `vapor-benchmark`: its options, and what it prints."""
