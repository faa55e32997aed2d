"""What differs from one walk through a building to another: light, and people."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

from sequences.scenes.building.people import draw_people
from sequences.scenes.building.plan import Plan, Spot
from sequences.scenes.scene import SPLITS


@dataclass(frozen=True)
class Visit:
    """What differs from one walk through a building to another.

    Attributes:
        lamps, daylight: How bright they are, 1 as usual.
        tint: Colour of the lamps.
        people: Level and place of everyone who stands about, in the world, and a number that says who.
    """

    lamps: float = 1.0
    daylight: float = 1.0
    tint: tuple[float, float, float] = (1.0, 0.95, 0.88)
    people: tuple[tuple[int, Spot, int], ...] = ()


@lru_cache(maxsize=100)
def draw_visit(plan: Plan, split: str, seed: int) -> Visit:
    """Light and people of one walk: by day and alone on training walks, at any hour and among people on others."""
    rng = plan.rng(16, SPLITS[split], seed)
    colour = (1.0, float(rng.uniform(0.85, 1.0)), float(rng.uniform(0.7, 1.0)))
    if split == "train":
        return Visit(float(rng.uniform(0.8, 1.2)), float(rng.uniform(0.5, 1.1)), colour)
    hour = float(rng.choice([0.02, 0.25, 0.8, 1.6]))  # night, dusk, overcast, sun
    return Visit(float(rng.uniform(0.5, 1.3)), hour * float(rng.uniform(0.8, 1.25)), colour, draw_people(plan, rng))
