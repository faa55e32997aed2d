"""Paths through a building: along corridors, round rooms, up and down stairs."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache
from itertools import pairwise

import numpy as np
from jaxtyping import Float64, Int64
from scipy.sparse import csr_array
from scipy.sparse.csgraph import shortest_path

from sequences.scenes.building.layout import layout
from sequences.scenes.building.plan import Block, Plan, Slot, Spot
from sequences.scenes.lines import distances_along

ASIDE_M = 0.05  # how far one comes off the way in doors, on stairs and in rooms
_WIDE_M = 0.4  # and at most in corridors
_CORRIDOR_M = 0.6  # that always stay to its walls


@dataclass(frozen=True)
class Station:
    """Somewhere to go: a room, an end of a corridor, a half landing.

    The way there ends at a node; a visit is the line from the node back to it, metres, or the node alone.
    """

    node: int
    visit: Float64[np.ndarray, "n 3"]


@dataclass(frozen=True)
class Ways:
    """A graph of paths through a building, metres.

    Nodes lie on the floor or the middle of the steps, with a sideways freedom at each. The shortest path from node i to
    node j has the length `far` and the last node `before` j. The tour leads through the whole building.
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

    def lengths_m(self) -> Float64[np.ndarray, " n1"]:
        """Distance along the tour at which each station is set off for, and its whole length, back to the first."""
        nodes = np.array([station.node for station in self.tour])
        inside = [distances_along(station.visit)[-1] for station in self.tour]
        return np.concatenate([[0.0], np.cumsum(self.far[nodes, np.roll(nodes, -1)] + inside)])


class _Net:
    def __init__(self) -> None:
        self.points: list[np.ndarray] = []
        self.freedom: list[float] = []
        self.edges: list[tuple[int, int]] = []

    def node(self, spot: Spot, x: float, y: float, z: float, freedom: float = ASIDE_M) -> int:
        self.points.append(np.array([*spot.points(np.array([[x, y]]))[0], z]))
        self.freedom.append(freedom)
        return len(self.points) - 1

    def join(self, *nodes: int) -> None:
        self.edges += list(pairwise(nodes))


@dataclass
class _Axis:
    net: _Net
    frame: Spot
    y: float
    z: float
    freedom: float
    nodes: list[tuple[float, int]] = field(default_factory=list)

    def node(self, x: float) -> int:
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
            freedom = float(np.clip(block.width / 2 - _CORRIDOR_M, ASIDE_M, _WIDE_M))
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
