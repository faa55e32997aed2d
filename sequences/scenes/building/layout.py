"""The furniture of a room, and the path through it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import TypeAlias

import numpy as np
from jaxtyping import Float64

from sequences.scenes.building.furniture import MIDDLE, WANTED, Piece, draw_furniture, radiator
from sequences.scenes.building.plan import DOOR_WIDTH, Plan, Slot, Spot
from sequences.scenes.lines import resampled

Rectangle: TypeAlias = tuple[float, float, float, float]
Box: TypeAlias = tuple[float, float, float, float, float]
"""x0, y0, x1, y1 and height of a piece of furniture."""
CLEARANCE_M = 0.5  # from where one walks to anything that stands on the floor
_INSET_M = 1.12  # from where one walks to the walls, where there is space
_DEEP_M = {"bedroom": 2.55, "living": 1.4, "library": 1.4, "kitchen": 1.15}  # along one of the walls
_SILL_M = 0.95
_TRIES = 40  # places tried for a piece of furniture


@dataclass(frozen=True)
class Layout:
    """A room in its own frame, metres: x along the wall with the door, from 0, y away from it.

    The middle of the door is at x = `door`. The walkway leads from it, clear of walls and furniture. Boxes are the
    footprint (x0, y0, x1, y1) and height of each piece of furniture; windows, opposite the door, are x0, x1, z0, z1.
    The door's leaf stands open along the wall from x0 to x1; None where it has no space.
    """

    width: float
    depth: float
    door: float
    walkway: Float64[np.ndarray, "n 2"]
    pieces: tuple[tuple[str, Spot], ...]
    boxes: Float64[np.ndarray, "k 5"]
    windows: tuple[Rectangle, ...]
    leaf: tuple[float, float] | None


@cache
def pieces_of(plan: Plan) -> dict[str, Piece]:
    """The furniture of a building; every type of it looks the same wherever it stands."""
    return {**draw_furniture(plan.rng(2)), "radiator": radiator()}


def layout(plan: Plan, slot: Slot, style: int) -> Layout:
    """The room behind a slot on the levels of one style; the same object for rooms that are alike."""
    width, depth = round(slot.end - slot.begin - plan.wall, 6), plan.depth(slot)
    near = slot.door - slot.begin - plan.wall / 2
    return _layout(plan, width, depth, round(near if slot.high else width - near, 6), slot.look, slot.variant, style)


@cache
def _layout(plan: Plan, width: float, depth: float, door: float, look: int, variant: int, style: int) -> Layout:
    rng = plan.rng(3, look, variant, style)
    kind = plan.kinds[look]
    walkway, middle = _walkway(width, depth, door, kind, rng)
    windows = _windows(plan, width, rng)
    taken: list[Box] = []
    placed: list[tuple[str, Spot]] = []
    leaf = None
    for x0 in (door + DOOR_WIDTH / 2 + 0.08, door - 3 * DOOR_WIDTH / 2 - 0.08):
        if leaf is None and x0 > 0.02 and x0 + DOOR_WIDTH < width - 0.02:
            leaf = (x0, x0 + DOOR_WIDTH)
            taken.append((x0 - 0.05, 0.0, x0 + DOOR_WIDTH + 0.05, 0.12, 2.1))
    pieces = pieces_of(plan)
    if windows and rng.random() < 0.6:
        x0 = (windows[0][0] + windows[0][1]) / 2 - 0.5
        placed.append(("radiator", Spot(x0 + 1.0, depth, np.pi)))
        taken.append((x0, depth - 0.12, x0 + 1.0, depth, 0.68))
    fine = resampled(walkway, 0.05)
    for name in WANTED[kind]:
        piece = pieces[name]
        for _ in range(_TRIES):
            spot, box = _against_wall(piece, width, depth, rng)
            if box is not None and _fits(box, taken, fine, door, windows, depth):
                placed.append((name, spot))
                taken.append(box)
                break
    if middle is not None:
        for spot, box in _in_rows(pieces[MIDDLE[kind]], middle):
            placed.append((MIDDLE[kind], spot))
            taken.append(box)
    boxes = np.array(taken).reshape(-1, 5)
    return Layout(width, depth, door, walkway, tuple(placed), boxes, tuple(windows), leaf)


def _in_rows(piece: Piece, middle: Rectangle) -> Iterator[tuple[Spot, Box]]:
    """As many pieces, up to nine, as fit into the middle of a room, in rows; each with the box that it takes."""
    x0, y0, x1, y1 = middle
    sides = (x1 - x0, piece.width), (y1 - y0, piece.depth)
    across, along = (min(3, int((space + 0.3) / (size + 0.3))) for space, size in sides)
    for i, j in np.ndindex(across, along):
        x = x0 + (x1 - x0) * (i + 0.5) / across - piece.width / 2
        y = y0 + (y1 - y0) * (j + 0.5) / along - piece.depth / 2
        yield Spot(x, y, 0.0), (x, y, x + piece.width, y + piece.depth, piece.height)


def _walkway(
    width: float, depth: float, door: float, kind: str, rng: np.random.Generator
) -> tuple[np.ndarray, Rectangle | None]:
    """Once round the room where it is large enough, else in and back; and the space in the middle for a table."""
    left = right = far = _INSET_M
    deep = _DEEP_M.get(kind, _INSET_M)
    side = rng.integers(3)
    if side < 2 and width - deep - _INSET_M > 0.6:
        left, right = (deep, right) if side else (left, deep)
    elif depth - deep - 1.1 > 0.6:
        far = deep
    x0, x1, y0, y1 = left, width - right, 1.1, depth - far
    if x1 - x0 < 0.55 or y1 - y0 < 0.55:
        x = float(np.clip(door, min(_INSET_M, width / 2), max(width - _INSET_M, width / 2)))
        return np.array([[door, 0.0], [door, 0.9], [x, max(depth - 1.0, 1.5)], [door, 0.9], [door, 0.0]]), None
    entry = float(np.clip(door, x0, x1))
    ring = [[x1, y0], [x1, y1], [x0, y1], [x0, y0]]
    if rng.random() < 0.5:
        ring = [ring[3], ring[2], ring[1], ring[0]]
    through = [[door, 0.0], [door, 0.75]]
    points = [*through, [entry, y0], *ring, [entry, y0], *through[::-1]]
    kept = [points[0], *(b for a, b in pairwise(points) if np.hypot(b[0] - a[0], b[1] - a[1]) > 1e-6)]
    gap = CLEARANCE_M + 0.02
    middle = (x0 + gap, y0 + gap, x1 - gap, y1 - gap)
    roomy = middle[2] > middle[0] and middle[3] > middle[1]
    return np.array(kept), middle if roomy else None


def _windows(plan: Plan, width: float, rng: np.random.Generator) -> list[Rectangle]:
    top = min(plan.clear - 0.2, rng.uniform(2.0, 2.4))
    count = 1 if width < 3.6 else int(rng.integers(1, 3))
    each = width / count
    size = min(each - 0.7, rng.uniform(1.0, 2.2))
    return [((k + 0.5) * each - size / 2, (k + 0.5) * each + size / 2, _SILL_M, top) for k in range(count)]


def _against_wall(piece: Piece, width: float, depth: float, rng: np.random.Generator) -> tuple[Spot, Box | None]:
    """A random place with its back to a wall, and the box that it takes; None where the wall is too short."""
    side, fraction = int(rng.integers(4)), rng.random()
    w, d, h, gap = piece.width, piece.depth, piece.height, 0.02
    free = (width if side < 2 else depth) - w - 2 * gap
    if free < 0:
        return Spot(0.0, 0.0, 0.0), None
    if rng.random() < 0.35:
        fraction = float(rng.integers(2))  # in a corner
    a = gap + fraction * free
    if side == 0:
        return Spot(a, gap, 0.0), (a, 0.0, a + w, d + gap, h)
    if side == 1:
        return Spot(a + w, depth - gap, np.pi), (a, depth - d - gap, a + w, depth, h)
    if side == 2:
        return Spot(gap, a + w, -np.pi / 2), (0.0, a, d + gap, a + w, h)
    return Spot(width - gap, a, np.pi / 2), (width - d - gap, a, width, a + w, h)


def _fits(box: Box, taken: list[Box], walked: np.ndarray, door: float, windows: list[Rectangle], depth: float) -> bool:
    x0, y0, x1, y1, height = box
    if any(x0 < b[2] and b[0] < x1 and y0 < b[3] and b[1] < y1 for b in taken):
        return False
    if y0 < 0.7 and x0 < door + DOOR_WIDTH / 2 + 0.15 and door - DOOR_WIDTH / 2 - 0.15 < x1:
        return False
    if y1 > depth - 0.3 and height > _SILL_M and any(x0 < w[1] + 0.1 and w[0] - 0.1 < x1 for w in windows):
        return False
    away = walked - np.clip(walked, (x0, y0), (x1, y1))
    return float(np.linalg.norm(away, axis=1).min()) > CLEARANCE_M
