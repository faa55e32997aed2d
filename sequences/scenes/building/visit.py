"""Light and people, which differ from one walk through a building to another."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np

from sequences.rendering.mesh import Part
from sequences.rendering.texture import plain
from sequences.scenes.building.layout import layout
from sequences.scenes.building.paint.colours import colour
from sequences.scenes.building.plan import Plan, Spot
from sequences.scenes.building.ways import ways
from sequences.scenes.scene import SPLITS

PERSON_RADIUS = 0.27  # of a circle around a person, metres


def person(rng: np.random.Generator) -> Part:
    """Someone who stands at the origin and looks along y: dressed, with arms, head and hair."""
    part, k = Part(), float(rng.uniform(0.9, 1.08))
    trousers, shirt = plain(colour(rng, 0.5, 0.12)), plain(colour(rng, 0.9, 0.35), amount=0.1)
    skin_tone = float(rng.uniform(0.25, 1.0))
    skin = plain((0.5 * skin_tone, 0.32 * skin_tone, 0.24 * skin_tone))
    hair = plain(colour(rng, 0.5, 0.07))
    for x in (-0.09, 0.09):
        part.box((x - 0.06, -0.1, 0), (x + 0.06, 0.16, 0.08 * k), plain((0.04, 0.04, 0.04)), "xXyYZ")
        part.beam((x, 0, 0.05), (x, 0, 0.86 * k), 0.085, trousers, 8)
    part.beam((0, 0, 0.82 * k), (0, 0, 1.12 * k), 0.165, shirt, 10)
    part.beam((0, 0, 1.1 * k), (0, 0, 1.42 * k), 0.185, shirt, 10)
    part.box((-0.13, -0.12, 1.41 * k), (0.13, 0.12, 1.43 * k), shirt, "Z")
    for x in (-0.2, 0.2):
        part.beam((x, 0.0, 1.4 * k), (1.1 * x, 0.03, 1.1 * k), 0.05, shirt, 6)
        part.beam((1.1 * x, 0.03, 1.1 * k), (x, 0.09, 0.84 * k), 0.04, skin, 6)
    part.beam((0, 0, 1.42 * k), (0, 0, 1.52 * k), 0.055, skin, 6)
    part.beam((0, 0.01, 1.5 * k), (0, 0.01, 1.7 * k), 0.1, skin, 10)
    part.beam((0, -0.02, 1.58 * k), (0, -0.02, 1.77 * k), 0.108, hair, 10)
    part.box((-0.08, -0.1, 1.765 * k), (0.08, 0.06, 1.77 * k), hair, "Z")
    return part


_PERSON_M = PERSON_RADIUS + 0.42  # from where one walks to the middle of a person


def draw_people(plan: Plan, rng: np.random.Generator) -> tuple[tuple[int, Spot, int], ...]:
    """Where people stand, away from where one walks and from what stands there, as `Visit.people` has it."""
    walked = _all_ways(plan)
    people: list[tuple[int, Spot, int]] = []
    places = [(block, None) for block in plan.blocks] + list(plan.slots("room"))
    for _ in range(int(rng.integers(1, 3 + 2 * plan.levels))):
        for _ in range(30):
            level, (block, slot) = int(rng.integers(plan.levels)), places[int(rng.integers(len(places)))]
            fraction, heading, who = rng.random(2), float(rng.uniform(-np.pi, np.pi)), int(rng.integers(1 << 30))
            if slot is None:
                frame, size, boxes = block.frame, np.array([block.length, block.width]), np.empty((0, 5))
            else:
                room = layout(plan, slot, plan.styles[level])
                frame, size, boxes = plan.frame_of(block, slot), np.array([room.width, room.depth]), room.boxes
            margin = PERSON_RADIUS + 0.03
            at = margin + fraction * (size - 2 * margin)
            beside = np.linalg.norm(at - np.clip(at, boxes[:, :2], boxes[:, 2:4]), axis=1)
            spot = Spot(float(at[0]), float(at[1]), heading).within(frame)
            here = np.array([spot.x, spot.y, level * plan.storey])
            apart = [np.hypot(other.x - spot.x, other.y - spot.y) for on, other, _ in people if on == level]
            if (
                np.linalg.norm(walked - here, axis=1).min() > _PERSON_M
                and (beside > margin).all()
                and min(apart, default=1.0) > 0.7
            ):
                people.append((level, spot, who))
                break
    return tuple(people)


@cache
def _all_ways(plan: Plan) -> np.ndarray:
    """Points (n, 3) every 10 cm of all ways."""
    net = ways(plan)
    lines = [station.visit for station in net.tour]
    nodes = np.stack([net.before, np.broadcast_to(np.arange(len(net.points)), net.before.shape)], axis=-1)
    lines += [net.points[edge] for edge in np.unique(nodes[net.before >= 0], axis=0)]
    pieces = [_resampled(line, 0.1) for line in lines]
    return np.concatenate([*pieces, net.points])


def _resampled(line: np.ndarray, spacing: float) -> np.ndarray:
    walked = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    at = np.arange(0.0, walked[-1], spacing)
    return np.stack([np.interp(at, walked, line[:, k]) for k in range(line.shape[1])], axis=1)


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
