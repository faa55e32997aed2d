"""One module a command of `vapor-benchmark`: its options and its output."""
