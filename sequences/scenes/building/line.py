"""The line of a walk through a building, and how far one can come off it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.ndimage import gaussian_filter1d, minimum_filter1d

from sequences.scenes.building.plan import Plan
from sequences.scenes.building.visit import Visit
from sequences.scenes.building.ways import ASIDE_M, Station, Ways, ways

TRAINING_WALKS = 5
"""So many training walks of seeds in a row begin evenly spread over a tour of the building."""

FINE_M = 0.02  # between points of a line that is walked
_BEFORE_TURN_M = 1.3
_ROUND_M = 0.16  # how much corners are rounded


def draw_line(
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
            *((point, ASIDE_M) for point in station.visit[1:]),
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
    at = np.arange(0.0, fine[-1], FINE_M)
    line = np.stack([np.interp(at, fine, rough[:, k]) for k in range(3)], axis=1)
    segment = np.clip(np.searchsorted(fine, at, side="right"), 1, len(fine) - 1)
    freedom = np.minimum(np.array(free)[segment - 1], np.array(free)[segment])
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
    again = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    at = np.arange(skipped, again[-1], FINE_M)
    return np.stack([np.interp(at, again, line[:, k]) for k in range(3)], axis=1), np.interp(at, again, freedom)


def _stations(net: Ways, training: bool, seed: int, rng: np.random.Generator) -> Iterator[Station]:
    """Where a walk goes, one after the other, without end."""
    count = len(net.tour)
    if training:
        fraction = (seed % TRAINING_WALKS) / TRAINING_WALKS
        first = int(np.searchsorted(net.lengths_m(), fraction * net.tour_m))
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
