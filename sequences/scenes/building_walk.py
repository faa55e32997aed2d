"""How bodies move through a building: along corridors, round rooms, up and down stairs."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from itertools import pairwise

import numpy as np
from jaxtyping import Float64, Int64
from scipy.ndimage import gaussian_filter1d, minimum_filter1d
from scipy.sparse import csr_array
from scipy.sparse.csgraph import shortest_path

from filtering.se3 import Poses
from sequences.scenes.building import Visit
from sequences.scenes.building_plan import Block, Plan, Slot, Spot
from sequences.scenes.building_rooms import layout
from sequences.scenes.furniture import PERSON_RADIUS
from sequences.scenes.paths import STEP_S, rotations, wander

TRAINING_WALKS = 5
"""So many training walks of seeds in a row begin evenly spread over a tour of the building."""

_ASIDE_M = 0.05  # how far one comes off the way in doors, on stairs and in rooms
_WIDE_M = 0.4  # and at most in corridors
_CORRIDOR_M = 0.6  # that always stay to its walls
_BEFORE_TURN_M = 1.3
_PERSON_M = PERSON_RADIUS + 0.42  # from where one walks to the middle of a person
_FINE_M = 0.02  # between points of a line that is walked
_BRAKING_M_PER_S2 = 0.6
_ROUND_M = 0.16  # how much corners are rounded


@dataclass(frozen=True)
class Station:
    """Somewhere to go: a room, an end of a corridor, a half landing.

    Attributes:
        node: Where the way there ends.
        visit: What is walked there, from the node back to it, metres; the node alone where there is nothing more.
    """

    node: int
    visit: Float64[np.ndarray, "n 3"]


@dataclass(frozen=True)
class Ways:
    """Where one can walk in a building.

    Attributes:
        points: The nodes, metres, on the floor or the middle of the steps.
        freedom: How far one can come off the way at each node, metres.
        before: Of the shortest way from node i to node j, the last node before j.
        far: How long that is, metres.
        tour: Stations in the order in which they are best visited, all over the building and back to the first.
    """

    points: Float64[np.ndarray, "n 3"]
    freedom: Float64[np.ndarray, " n"]
    before: Int64[np.ndarray, "n n"]
    far: Float64[np.ndarray, "n n"]
    tour: tuple[Station, ...]

    def way(self, begin: int, end: int) -> list[int]:
        """The nodes of the shortest way, both ends included."""
        nodes = [end]
        while nodes[-1] != begin:
            nodes.append(int(self.before[begin, nodes[-1]]))
        return nodes[::-1]

    def lengths_m(self) -> Float64[np.ndarray, " n"]:
        """How far one has walked on the tour when one sets off for each station from the one before."""
        nodes = [station.node for station in self.tour]
        inside = [float(np.linalg.norm(np.diff(s.visit, axis=0), axis=1).sum()) for s in self.tour]
        return np.concatenate([[0.0], np.cumsum([self.far[a, b] for a, b in pairwise(nodes)] + np.array(inside[:-1]))])

    @property
    def tour_m(self) -> float:
        """Length of the whole tour."""
        last = float(np.linalg.norm(np.diff(self.tour[-1].visit, axis=0), axis=1).sum())
        return float(self.lengths_m()[-1]) + last + float(self.far[self.tour[-1].node, self.tour[0].node])


class _Net:
    """Nodes and the straight ways between them, under construction."""

    def __init__(self) -> None:
        self.points: list[np.ndarray] = []
        self.freedom: list[float] = []
        self.edges: list[tuple[int, int]] = []

    def node(self, spot: Spot, x: float, y: float, z: float, freedom: float = _ASIDE_M) -> int:
        """A point told in a frame."""
        self.points.append(np.array([*spot.points(np.array([[x, y]]))[0], z]))
        self.freedom.append(freedom)
        return len(self.points) - 1

    def join(self, *nodes: int) -> None:
        """Straight ways from each to the next."""
        self.edges += list(pairwise(nodes))


@dataclass
class _Axis:
    """The middle line of a corridor, along x of its frame, and the nodes on it by x; metres."""

    net: _Net
    frame: Spot
    y: float
    z: float
    freedom: float
    nodes: list[tuple[float, int]] = field(default_factory=list)

    def node(self, x: float) -> int:
        """A new one."""
        self.nodes.append((x, self.net.node(self.frame, x, self.y, self.z, self.freedom)))
        return self.nodes[-1][1]


@cache
def ways(plan: Plan) -> Ways:
    """All ways through a building."""
    net = _Net()
    stations: list[list[tuple[float, Station]]] = [[] for _ in range(plan.levels)]
    landings: dict[tuple[int, int], tuple[int, int]] = {}
    wing_doors: dict[int, int] = {}
    wells = [slot for _, slot in plan.slots("stairs")]
    for level in range(plan.levels):
        for index, block in enumerate(plan.blocks):
            z, middle = level * plan.storey, block.width / 2
            freedom = float(np.clip(block.width / 2 - _CORRIDOR_M, _ASIDE_M, _WIDE_M))
            axis = _Axis(net, block.frame, middle, z, freedom)
            for x in (-plan.wall if block.open_start else 0.9, block.length - 0.9):
                end = axis.node(x)
                if block.open_start and x < 0:
                    net.join(wing_doors[level], end)
                else:
                    stations[level].append((100.0 * index + x, _alone(net, end)))
            for slot in block.slots:
                if slot.kind == "room":
                    inside, visit = _into(plan, net, block, slot, level)
                    net.join(axis.node(slot.door), inside)
                    stations[level].append((100.0 * index + slot.door, Station(inside, visit)))
                elif slot.kind == "wing":
                    wing_doors[level] = axis.node(slot.door)
                elif slot.kind == "stairs":
                    frame, stairs = plan.frame_of(block, slot), plan.stairs
                    up, down = np.mean(stairs.up_x), np.mean(stairs.down_x)
                    both = [net.node(frame, float(x), 0.45 * stairs.landing, z) for x in (up, down)]
                    net.join(*both)
                    for x, node in zip((up, down), both, strict=True):
                        net.join(axis.node(float(slot.begin + x if slot.high else slot.end - x)), node)
                    landings[level, wells.index(slot)] = both[0], both[1]
            net.join(*(node for _, node in sorted(axis.nodes)))
    half_landings = _climb(plan, net, landings)
    tour: list[Station] = []
    for level in range(plan.levels):
        found = [station for _, station in sorted(stations[level], key=lambda entry: entry[0])]
        tour += found[::-1] if level % 2 else found
        if level < plan.levels - 1:
            tour.append(_alone(net, half_landings[level, level % len(wells)]))
    for level in range(plan.levels - 2, -1, -1):  # down again by the other stairs
        if len(wells) > 1:
            tour.append(_alone(net, half_landings[level, (level + 1) % len(wells)]))
    points = np.array(net.points)
    i, j = np.array(net.edges).T
    lengths = np.linalg.norm(points[i] - points[j], axis=1)
    graph = csr_array((lengths, (i, j)), shape=(len(points), len(points)))
    far, before = shortest_path(graph, directed=False, return_predecessors=True)
    return Ways(points, np.array(net.freedom), before.astype(np.int64), far, tuple(tour))


def _alone(net: _Net, node: int) -> Station:
    return Station(node, net.points[node][None])


def _into(plan: Plan, net: _Net, block: Block, slot: Slot, level: int) -> tuple[int, np.ndarray]:
    """A node just behind a room's door, and once round the room from there."""
    frame, room = plan.frame_of(block, slot), layout(plan, slot, plan.styles[level])
    z = level * plan.storey
    inside = net.node(frame, float(room.walkway[1, 0]), float(room.walkway[1, 1]), z)
    around = frame.points(room.walkway[1:-1])
    return inside, np.column_stack([around, np.full(len(around), z)])


def _climb(plan: Plan, net: _Net, landings: dict[tuple[int, int], tuple[int, int]]) -> dict[tuple[int, int], int]:
    """Ways up all stairs; the nodes in the middle, by level and stairwell."""
    stairs, halfway = plan.stairs, {}
    up, down = float(np.mean(stairs.up_x)), float(np.mean(stairs.down_x))
    near, far = stairs.landing - stairs.going / 2, stairs.landing + stairs.run + stairs.going / 2
    back = stairs.landing + stairs.run + 0.55 * stairs.half_landing
    for well, (block, slot) in enumerate(plan.slots("stairs")):
        frame = plan.frame_of(block, slot)
        for level in range(plan.levels - 1):
            z, half = level * plan.storey, (level + 0.5) * plan.storey
            line = [(up, near, z), (up, far, half), (up, back, half), (down, back, half)]
            line += [(down, far, half), (down, near, z + plan.storey)]
            nodes = [net.node(frame, *point) for point in line]
            net.join(landings[level, well][0], *nodes, landings[level + 1, well][1])
            halfway[level, well] = nodes[3]
    return halfway


def draw_people(plan: Plan, rng: np.random.Generator) -> tuple[tuple[int, Spot, int], ...]:
    """Where people stand, away from where one walks and from what stands there, as `Visit.people` has it."""
    walked = _all_ways(plan)
    people: list[tuple[int, Spot, int]] = []
    places = [(block, None) for block in plan.blocks] + list(plan.slots("room"))
    for _ in range(int(rng.integers(1, 3 + 2 * plan.levels))):
        for _ in range(30):
            level, (block, slot) = int(rng.integers(plan.levels)), places[int(rng.integers(len(places)))]
            share, heading, who = rng.random(2), float(rng.uniform(-np.pi, np.pi)), int(rng.integers(1 << 30))
            if slot is None:
                frame, size, boxes = block.frame, np.array([block.length, block.width]), np.empty((0, 5))
            else:
                room = layout(plan, slot, plan.styles[level])
                frame, size, boxes = plan.frame_of(block, slot), np.array([room.width, room.depth]), room.boxes
            margin = PERSON_RADIUS + 0.03
            at = margin + share * (size - 2 * margin)
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


def walk_building(
    plan: Plan, visit: Visit, duration_s: float, *, training: bool, seed: int, rng: np.random.Generator
) -> Poses:
    """Someone going through a building: world_from_base every 20 ms, x forward, z up, on the floor.

    Training walks follow a tour of the whole building, either way; those of `TRAINING_WALKS` seeds in a row begin
    evenly spread over it. Other walks go from one random place to another.

    Args:
        plan: The building.
        visit: Who stands in the way.
        duration_s: How long.
        training: Whether to follow the tour.
        seed: Where on the tour a training walk begins.
        rng: Of all that is random.
    """
    steps = int(np.ceil(duration_s / STEP_S)) + 1
    manner = plan.rng(14)  # wheels roll, legs sway
    sway, tilt = float(manner.uniform(0.0, 0.02)), float(manner.uniform(0.002, 0.02))
    pace = float(rng.uniform(0.45, 1.0) if training else rng.uniform(0.4, 1.05))
    quickest = float(rng.uniform(0.9, 1.7))  # turn, rad/s
    line, freedom = _line(plan, visit, 1.15 * pace * duration_s + 3.0, training, seed, rng)
    heading, fastest = _headings(line)
    wanted = pace * np.clip(1 + 0.08 * wander(steps, 5.0, rng), 0.85, 1.15)
    chance = rng.random((steps, 2))
    s, speed, yaw, rate, pause = 0.0, 0.0, float(heading[0]), 0.0, 0.0
    place, yaws, speeds = np.empty(steps), np.empty(steps), np.empty(steps)
    last = (len(line) - 2) * _FINE_M
    for i in range(steps):
        error = (heading[int(s / _FINE_M)] - yaw + np.pi) % (2 * np.pi) - np.pi
        rate += (min(max(error / 0.35, -quickest), quickest) - rate) * STEP_S / 0.12
        yaw += rate * STEP_S
        if pause <= 0 and chance[i, 0] < STEP_S / 30:
            pause = 0.5 + 2.0 * chance[i, 1]
        pause -= STEP_S
        goal = 0.0 if pause > 0 else wanted[i] * min(max(1.2 - abs(error) / 0.7, 0.0), 1.0)
        speed = min(speed + (goal - speed) * STEP_S / 0.3, _between(fastest, s / _FINE_M))
        s = min(s + speed * STEP_S, last)
        place[i], yaws[i], speeds[i] = s, yaw, speed
    at = place / _FINE_M
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
    """Where one looks along a line, to what lies a little ahead; and how fast one can be, as one stops to turn back."""
    index, reach = np.arange(len(line)), round(0.1 / _FINE_M)
    step = line[reach:, :2] - line[:-reach, :2]
    back = np.concatenate([[False], np.einsum("nk,nk->n", step[:-reach], step[reach:]) < 0, [False]])
    begin, end = np.flatnonzero(np.diff(back.astype(int)) == 1), np.flatnonzero(np.diff(back.astype(int)) == -1)
    turns = reach + (begin + end - 1) // 2
    edges = np.concatenate([[0], turns, [len(line) - 1]])
    stretch = np.clip(np.searchsorted(edges, index, side="right"), 1, len(edges) - 1)
    ahead = np.minimum(index + round(0.3 / _FINE_M), edges[stretch])
    behind = np.maximum(index - round(0.1 / _FINE_M), edges[stretch - 1])
    heading = np.arctan2(*(line[ahead, :2] - line[behind, :2]).T[::-1])
    to_turn = np.concatenate([[-len(line)], turns, [2 * len(line)]])
    following = np.searchsorted(to_turn, index)
    away = np.minimum(to_turn[following] - index, index - to_turn[following - 1]) * _FINE_M
    return heading, 0.03 + np.sqrt(_BRAKING_M_PER_S2 * 2 * away)


def _tangent(line: np.ndarray) -> np.ndarray:
    """Direction of a line, changing slowly enough to be a direction to step aside in."""
    step = gaussian_filter1d(np.gradient(line[:, :2], axis=0), 10, axis=0, mode="nearest")
    return np.arctan2(step[:, 1], step[:, 0])


def _line(
    plan: Plan, visit: Visit, length_m: float, training: bool, seed: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """A line (n, 3) with points every 2 cm that is at least so long, and how far one can come off it (n,)."""
    net, skipped = ways(plan), float(rng.uniform(0.0, 4.0))
    corners, free, walked = [], [], 0.0
    before: int | None = None
    for station in _stations(net, training, seed, rng):
        nodes = net.way(before, station.node)[1:] if before is not None else [station.node]
        for point, freedom in [
            *((net.points[node], net.freedom[node]) for node in nodes),
            *((point, _ASIDE_M) for point in station.visit[1:]),
        ]:
            if corners:
                step = float(np.linalg.norm(point - corners[-1]))
                if step < 1e-6:
                    continue
                walked += step
            corners.append(point)
            free.append(freedom)
        before = station.node
        if walked > length_m + skipped + 1.0:
            break
    rough = np.array(corners)
    fine = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(rough, axis=0), axis=1))])
    at = np.arange(0.0, fine[-1], _FINE_M)
    line = np.stack([np.interp(at, fine, rough[:, k]) for k in range(3)], axis=1)
    stretch = np.clip(np.searchsorted(fine, at, side="right"), 1, len(fine) - 1)
    freedom = np.minimum(np.array(free)[stretch - 1], np.array(free)[stretch])
    for level, spot, _ in visit.people:
        near = np.linalg.norm(line - (spot.x, spot.y, level * plan.storey), axis=1) < 1.0
        freedom[near] = _ASIDE_M
    heading = np.unwrap(np.arctan2(*np.diff(line[:, :2], axis=0).T[::-1]))
    turn = np.abs(np.diff(heading))
    freedom[1:-1][turn > 0.3] = _ASIDE_M
    freedom[1:-1][turn > 2.0] = 0.0  # left becomes right
    freedom = minimum_filter1d(freedom, 2 * round(_BEFORE_TURN_M / _FINE_M), mode="nearest")
    freedom = gaussian_filter1d(freedom, 0.3 / _FINE_M, mode="nearest")
    line = gaussian_filter1d(line, _ROUND_M / _FINE_M, axis=0, mode="nearest")
    again = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    at = np.arange(skipped, again[-1], _FINE_M)
    return np.stack([np.interp(at, again, line[:, k]) for k in range(3)], axis=1), np.interp(at, again, freedom)


def _stations(net: Ways, training: bool, seed: int, rng: np.random.Generator) -> Iterator[Station]:
    """Where a walk goes, one after the other, without end."""
    count = len(net.tour)
    if training:
        share = (seed % TRAINING_WALKS) / TRAINING_WALKS
        first = int(np.searchsorted(net.lengths_m(), share * net.tour_m))
        way = 1 if seed // TRAINING_WALKS % 2 == 0 else -1
        k = first
        while True:
            yield net.tour[k % count]
            k += way
    last = -1
    while True:
        k = int(rng.integers(count))
        if k != last or count == 1:
            last = k
            yield net.tour[k]
