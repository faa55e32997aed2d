"""Where people stand about in a building."""

from __future__ import annotations

from functools import cache

import numpy as np

from sequences.scenes.building.layout import layout
from sequences.scenes.building.person import PERSON_RADIUS
from sequences.scenes.building.plan import Plan, Spot
from sequences.scenes.building.ways import ways

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
