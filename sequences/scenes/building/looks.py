"""What a building is made of on a visit."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

from sequences.rendering.texture import Material
from sequences.scenes.building.paint.palette import Palette, draw_palette
from sequences.scenes.building.plan import Plan


@dataclass(frozen=True)
class Looks:
    """What a building is made of on a visit.

    Attributes:
        palettes: How the levels of each style are painted.
        lamp, pane: The light of lamps, and what lies behind windows.
        lamp_size: Sides of a lamp, metres.
        lamp_spacing: From lamp to lamp, metres.
    """

    palettes: tuple[Palette, ...]
    lamp: Material
    pane: Material
    lamp_size: tuple[float, float]
    lamp_spacing: float


@cache
def palettes(plan: Plan) -> tuple[Palette, ...]:
    """How the levels of each style are painted."""
    return tuple(draw_palette(plan.rng(1, style), len(plan.kinds)) for style in range(max(plan.styles) + 1))
