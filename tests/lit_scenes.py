"""Loaded by a process that others are forked from: scenes that they need are lit once, which takes a second a scene."""

from sequences.place import load_scene

SCENES = [load_scene(name) for name in ("ceiling", "dinner-table")]
