"""Rendering: parallelograms, their paint, the light on them, and rays."""
