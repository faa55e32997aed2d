"""A walk through a building: its light and people, the line of the walk, and the motion along it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np
from scipy.ndimage import gaussian_filter1d, minimum_filter1d

from filtering.se3 import Poses
from sequences.paths import STEP_S, rotations, wander
from sequences.rendering.mesh import Part
from sequences.rendering.texture import plain
from sequences.scenes.building.layout import layout
from sequences.scenes.building.paint import colour
from sequences.scenes.building.plan import Plan, Spot
from sequences.scenes.building.ways import ASIDE_M, Station, Ways, ways
from sequences.scenes.lines import distances_along, points_at, resampled
from sequences.scenes.scene import SPLITS

PERSON_RADIUS = 0.27  # of a circle around a person, metres


def person(rng: np.random.Generator) -> Part:
    """Someone who stands at the origin and looks along y: dressed, with arms, head and hair."""
    part, k = Part(), rng.uniform(0.9, 1.08)
    trousers, shirt = plain(colour(rng, 0.5, 0.12)), plain(colour(rng, 0.9, 0.35), amount=0.1)
    skin_tone = rng.uniform(0.25, 1.0)
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
    """`Visit.people`: clear of paths and furniture."""
    walked = _all_ways(plan)
    people: list[tuple[int, Spot, int]] = []
    places = [(block, None) for block in plan.blocks] + list(plan.slots("room"))
    for _ in range(int(rng.integers(1, 3 + 2 * plan.levels))):
        for _ in range(30):
            level, (block, slot) = int(rng.integers(plan.levels)), places[int(rng.integers(len(places)))]
            fraction, heading, who = rng.random(2), rng.uniform(-np.pi, np.pi), int(rng.integers(1 << 30))
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
    net = ways(plan)
    lines = [station.visit for station in net.tour]
    nodes = np.stack([net.before, np.broadcast_to(np.arange(len(net.points)), net.before.shape)], axis=-1)
    lines += [net.points[edge] for edge in np.unique(nodes[net.before >= 0], axis=0)]
    pieces = [resampled(line, 0.1) for line in lines]
    return np.concatenate([*pieces, net.points])


@dataclass(frozen=True)
class Visit:
    """A walk through a building, of a seed: its light and people.

    Lamps and daylight are as bright as usual at 1; the tint is the colour of the lamps. People have a level, a place in
    the world, and a seed of their looks.
    """

    is_training: bool
    seed: int
    lamps: float
    daylight: float
    tint: tuple[float, float, float]
    people: tuple[tuple[int, Spot, int], ...] = ()


@lru_cache(maxsize=100)
def draw_visit(plan: Plan, split: str, seed: int) -> Visit:
    """Light and people of one walk: by day and alone on training walks, at any hour and among people on others."""
    rng = plan.rng(16, SPLITS[split], seed)
    colour = (1.0, rng.uniform(0.85, 1.0), rng.uniform(0.7, 1.0))
    if split == "train":
        return Visit(True, seed, rng.uniform(0.8, 1.2), rng.uniform(0.5, 1.1), colour)
    hour = float(rng.choice([0.02, 0.25, 0.8, 1.6]))  # night, dusk, overcast, sun
    lamps, daylight = rng.uniform(0.5, 1.3), hour * rng.uniform(0.8, 1.25)
    return Visit(False, seed, lamps, daylight, colour, draw_people(plan, rng))


TRAINING_WALKS = 5
"""So many training walks of seeds in a row begin evenly spread over a tour of the building."""

FINE_M = 0.02  # between points of a line that is walked
_BEFORE_TURN_M = 1.3
_ROUND_M = 0.16  # how much corners are rounded


def draw_line(plan: Plan, visit: Visit, length_m: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A line (n, 3) with points every 2 cm that is at least so long, and how far one can come off it (n,)."""
    net, skipped = ways(plan), rng.uniform(0.0, 4.0)
    corners, free = np.empty((0, 3)), np.empty(0)
    before: int | None = None
    for station in _stations(net, visit, rng):
        nodes = net.way(before, station.node)[1:] if before is not None else [station.node]
        corners = np.concatenate([corners, net.points[nodes], station.visit[1:]])
        free = np.concatenate([free, net.freedom[nodes], np.full(len(station.visit) - 1, ASIDE_M)])
        before = station.node
        if distances_along(corners)[-1] > length_m + skipped + 1.0:
            break
    moves = np.linalg.norm(np.diff(corners, axis=0, prepend=np.inf), axis=1) >= 1e-6
    corners, free = corners[moves], free[moves]
    line, walked = resampled(corners, FINE_M), distances_along(corners)
    segment = np.clip(np.searchsorted(walked, np.arange(0.0, walked[-1], FINE_M), side="right"), 1, len(walked) - 1)
    freedom = np.minimum(free[segment - 1], free[segment])
    for level, spot, _ in visit.people:
        near = np.linalg.norm(line - (spot.x, spot.y, level * plan.storey), axis=1) < 1.0
        freedom[near] = ASIDE_M
    heading = np.unwrap(np.arctan2(*np.diff(line[:, :2], axis=0).T[::-1]))
    turn = np.abs(np.diff(heading))
    freedom[1:-1][turn > 0.3] = ASIDE_M
    freedom[1:-1][turn > 2.0] = 0.0  # left becomes right
    freedom = minimum_filter1d(freedom, 2 * round(_BEFORE_TURN_M / FINE_M), mode="nearest")
    freedom = gaussian_filter1d(freedom, 0.3 / FINE_M, mode="nearest")
    line = gaussian_filter1d(line, _ROUND_M / FINE_M, axis=0, mode="nearest")
    again = distances_along(line)
    at = np.arange(skipped, again[-1], FINE_M)
    return points_at(line, at), np.interp(at, again, freedom)


def _stations(net: Ways, visit: Visit, rng: np.random.Generator) -> Iterator[Station]:
    """The stations of a walk, without end."""
    count = len(net.tour)
    if visit.is_training:
        lengths_m = net.lengths_m()
        k = int(np.searchsorted(lengths_m, (visit.seed % TRAINING_WALKS) / TRAINING_WALKS * lengths_m[-1]))
        way = 1 if visit.seed // TRAINING_WALKS % 2 == 0 else -1
        while True:
            yield net.tour[k % count]
            k += way
    last = -1
    while True:
        k = int(rng.integers(count))
        if k != last or count == 1:
            last = k
            yield net.tour[k]


_BRAKING_M_PER_S2 = 0.6


def walk_building(plan: Plan, visit: Visit, duration_s: float, *, rng: np.random.Generator) -> Poses:
    """Someone going through a building: world_from_base every 20 ms, x forward, z up, on the floor.

    Training walks follow a tour of the whole building, either way; those of `TRAINING_WALKS` seeds in a row begin
    evenly spread over it. Other walks go from one random place to another. People stand in the way.
    """
    steps = int(np.ceil(duration_s / STEP_S)) + 1
    manner = plan.rng(14)  # wheels roll, legs sway
    sway, tilt = float(manner.uniform(0.0, 0.02)), float(manner.uniform(0.002, 0.02))
    pace = float(rng.uniform(0.45, 1.0) if visit.is_training else rng.uniform(0.4, 1.05))
    quickest = rng.uniform(0.9, 1.7)  # turn, rad/s
    line, freedom = draw_line(plan, visit, 1.15 * pace * duration_s + 3.0, rng)
    heading, fastest = _headings(line)
    wanted = pace * np.clip(1 + 0.08 * wander(steps, 5.0, rng), 0.85, 1.15)
    chance = rng.random((steps, 2))
    s, speed, yaw, rate, pause = 0.0, 0.0, float(heading[0]), 0.0, 0.0
    place, yaws, speeds = np.empty(steps), np.empty(steps), np.empty(steps)
    last = (len(line) - 2) * FINE_M
    for i in range(steps):
        error = (heading[int(s / FINE_M)] - yaw + np.pi) % (2 * np.pi) - np.pi
        rate += (min(max(error / 0.35, -quickest), quickest) - rate) * STEP_S / 0.12
        yaw += rate * STEP_S
        if pause <= 0 and chance[i, 0] < STEP_S / 30:
            pause = 0.5 + 2.0 * chance[i, 1]
        pause -= STEP_S
        goal = 0.0 if pause > 0 else wanted[i] * min(max(1.2 - abs(error) / 0.7, 0.0), 1.0)
        speed = min(speed + (goal - speed) * STEP_S / 0.3, _between(fastest, s / FINE_M))
        s = min(s + speed * STEP_S, last)
        place[i], yaws[i], speeds[i] = s, yaw, speed
    at = place / FINE_M
    here = np.stack([np.interp(at, np.arange(len(line)), line[:, k]) for k in range(3)], axis=1)
    aside = np.interp(at, np.arange(len(line)), freedom) * np.tanh(wander(steps, 5.0, rng))
    across = np.interp(at, np.arange(len(line)), np.unwrap(_tangent(line)))
    here[:, 0] -= aside * np.sin(across)
    here[:, 1] += aside * np.cos(across)
    stride = gaussian_filter1d(np.clip(speeds / 0.5, 0, 1), 0.2 / STEP_S)
    phase = np.pi * np.cumsum(speeds) * STEP_S / 0.5 + rng.uniform(0, 2 * np.pi)
    here[:, 2] += sway * stride * np.cos(2 * phase)
    glance = 0.14 * wander(steps, 2.0, rng) + 0.5 * sway * stride * np.sin(phase)
    pitch = tilt * wander(steps, 1.2, rng) + 0.3 * sway * stride * np.sin(2 * phase + 1.0)
    roll = tilt * wander(steps, 1.0, rng) + 0.5 * sway * stride * np.sin(phase)
    return Poses(rotations(yaws + glance, np.clip(pitch, -0.06, 0.06), np.clip(roll, -0.05, 0.05)), here)


def _between(values: np.ndarray, at: float) -> float:
    index = int(at)
    return float(values[index] + (at - index) * (values[index + 1] - values[index]))


def _headings(line: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Heading towards the points a little ahead, and the highest speed, which falls to turn back."""
    index, reach = np.arange(len(line)), round(0.1 / FINE_M)
    step = line[reach:, :2] - line[:-reach, :2]
    back = np.concatenate([[False], np.einsum("nk,nk->n", step[:-reach], step[reach:]) < 0, [False]])
    begin, end = np.flatnonzero(np.diff(back.astype(int)) == 1), np.flatnonzero(np.diff(back.astype(int)) == -1)
    turns = reach + (begin + end - 1) // 2
    edges = np.concatenate([[0], turns, [len(line) - 1]])
    segment = np.clip(np.searchsorted(edges, index, side="right"), 1, len(edges) - 1)
    ahead = np.minimum(index + round(0.3 / FINE_M), edges[segment])
    behind = np.maximum(index - round(0.1 / FINE_M), edges[segment - 1])
    heading = np.arctan2(*(line[ahead, :2] - line[behind, :2]).T[::-1])
    to_turn = np.concatenate([[-len(line)], turns, [2 * len(line)]])
    following = np.searchsorted(to_turn, index)
    away = np.minimum(to_turn[following] - index, index - to_turn[following - 1]) * FINE_M
    return heading, 0.03 + np.sqrt(_BRAKING_M_PER_S2 * 2 * away)


def _tangent(line: np.ndarray) -> np.ndarray:
    """Direction of a line, changing slowly enough to be a direction to step aside in."""
    step = gaussian_filter1d(np.gradient(line[:, :2], axis=0), 10, axis=0, mode="nearest")
    return np.arctan2(step[:, 1], step[:, 0])
