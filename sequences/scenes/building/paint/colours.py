"""Colours of a building."""

from __future__ import annotations

import colorsys

import numpy as np

Rgb = tuple[float, float, float]
WALL_TEXEL_M, FINE_TEXEL_M = 0.015, 0.008


def colour(rng: np.random.Generator, saturation: float, brightness: float) -> Rgb:
    """Linear reflectance of any hue."""
    return colorsys.hsv_to_rgb(
        float(rng.random()), float(rng.uniform(0.4, 1.0)) * saturation, brightness * float(rng.uniform(0.7, 1.4))
    )


def scaled(rgb: Rgb, by: float) -> Rgb:
    """A colour made brighter or darker."""
    return rgb[0] * by, rgb[1] * by, rgb[2] * by


def light_colour(rng: np.random.Generator) -> Rgb:
    """A pale colour of any hue."""
    return colorsys.hsv_to_rgb(float(rng.random()), float(rng.uniform(0.02, 0.28)), float(rng.uniform(0.45, 0.72)))


def grey(rng: np.random.Generator, low: float = 0.2, high: float = 0.5) -> Rgb:
    """A grey with a tinge of any hue, of a brightness in this range."""
    return colorsys.hsv_to_rgb(float(rng.random()), 0.08, float(rng.uniform(low, high)))
