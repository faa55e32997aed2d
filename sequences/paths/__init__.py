"""Paths of a body through a scene: how it moves, which of many random paths a sequence takes, where it stands."""
