"""One module a command of `vapor-track`: its options and its output."""
