"""A hall whose ceiling repeats itself: panels of 0.6 m, a lamp and a loudspeaker per 3 m × 3.6 m, few unique things."""

from __future__ import annotations

import numpy as np

from filtering.se3 import Poses
from sequences.paths import STEP_S, rotations, wander
from sequences.rendering import texture
from sequences.rendering.mesh import Part, Placement
from sequences.rendering.texture import Canvas, Material, band, blend, inside, plain, weathered
from sequences.scenes.scene import Scene, mounted_upward

LENGTH, BREADTH, HEIGHT = 15.0, 10.8, 3.6  # metres, x, y, z
PANEL = 0.6
CELL = (5, 6)  # panels after which lamps and loudspeakers repeat, in x and in y
LAMP_AT = (1, 2)  # panel of a cell under which its lamp begins
SPEAKER_AT = (4, 3)
OUTLET_AT = (19, 14)  # panels of the hall that unique things take
HOLE_AT = (16, 3)
STAIN_AT = ((5, 14), (6, 14), (5, 15))
PROJECTOR_AT = (5.1, 3.3)  # metres
SIGN_AT = (13.2, 5.1)


def _grid(canvas: Canvas, base: np.ndarray) -> np.ndarray:
    x, y = canvas.x % PANEL, canvas.y % PANEL
    edge = np.minimum(np.minimum(x, PANEL - x), np.minimum(y, PANEL - y))
    base = base * (1 - 0.6 * np.exp(-np.clip(edge - 0.016, 0, None) / 0.009) * (edge > 0.016))[..., None]
    return blend(base, (0.86, 0.86, 0.84), edge < 0.016)


def _tile(canvas: Canvas) -> np.ndarray:
    base = canvas.colour((0.70, 0.69, 0.655)) * (1 + 0.02 * canvas.noise(0.2) + 0.02 * canvas.noise(0.01))[..., None]
    fissures = np.clip(canvas.noise(0.035, 0.012) - 1.5, 0, 0.5) + np.clip(canvas.noise(0.012) - 2.2, 0, 0.5)
    base = blend(base, (0.26, 0.25, 0.23), fissures)
    holes = np.hypot(canvas.x % 0.05 - 0.025, canvas.y % 0.05 - 0.025) < 0.006
    base = blend(base, (0.12, 0.115, 0.11), 0.85 * holes)
    return _grid(canvas, base)


def _speaker(canvas: Canvas) -> np.ndarray:
    base = _tile(canvas)
    radius = np.hypot(canvas.x - 0.3, canvas.y - 0.3)
    ring = np.clip(np.sin(radius * 2 * np.pi / 0.02), 0, 1)
    base = blend(base, (0.42, 0.42, 0.41), 1 - texture.step(radius, 0.165))
    base = blend(base, (0.05, 0.05, 0.05), ring * (radius < 0.145))
    return blend(base, (0.75, 0.75, 0.72), band(radius, 0.15, 0.165))


def _diffuser(canvas: Canvas) -> np.ndarray:
    glow = np.exp(-(((canvas.y - canvas.height_m / 2) / 0.09) ** 2))
    base = canvas.colour((1.0, 0.97, 0.90)) * (0.4 + 0.6 * glow + 0 * canvas.x)[..., None]
    blades = 1 - band(canvas.x % 0.1, 0.008, 0.092)
    base = blend(base, (0.20, 0.20, 0.195), blades + 0 * canvas.y)
    return blend(base, (0.5, 0.5, 0.49), 1 - band(canvas.y, 0.02, canvas.height_m - 0.02) + 0 * canvas.x)


def _floor(canvas: Canvas) -> np.ndarray:
    return weathered(canvas, canvas.colour((0.46, 0.43, 0.38)), 0.1)


def _outlet_art(canvas: Canvas) -> np.ndarray:
    reach = np.maximum(np.abs(canvas.x - 0.3), np.abs(canvas.y - 0.3))
    gaps = (reach % 0.055) < 0.026
    base = canvas.colour((0.62, 0.62, 0.60)) * (1 + 0.03 * canvas.noise(0.1))[..., None]
    base = blend(base, (0.015, 0.015, 0.015), gaps * (reach < 0.27))
    soot = np.exp(-np.abs(reach - 0.28) / 0.03) * 0.4
    return blend(base, (0.10, 0.09, 0.08), soot)


def _stain(canvas: Canvas) -> np.ndarray:
    base = _tile(canvas)
    radius = np.hypot(canvas.x - 0.3, canvas.y - 0.3) + 0.03 * canvas.noise(0.12) + 0.008 * canvas.noise(0.03)
    base = blend(base, (0.42, 0.27, 0.11), 0.75 * (1 - texture.step(radius, 0.22, 0.05)))
    base = blend(base, (0.22, 0.10, 0.03), 0.9 * np.exp(-(((radius - 0.215) / 0.014) ** 2)))
    return blend(base, (0.25, 0.13, 0.05), 0.7 * np.exp(-(((radius - 0.12) / 0.012) ** 2)))


def _sign_art(canvas: Canvas) -> np.ndarray:
    base = canvas.colour((0.01, 0.42, 0.12))
    base = blend(base, (0.9, 1.0, 0.92), inside(canvas, 0.36, 0.05, 0.50, 0.25))
    shaft = inside(canvas, 0.14, 0.13, 0.30, 0.17)
    head = band(canvas.x, 0.06, 0.15) * (np.abs(canvas.y - 0.15) < (canvas.x - 0.06) * 0.9)
    return blend(base, (0.9, 1.0, 0.92), np.maximum(shaft, head))


def _panelled(canvas: Canvas) -> np.ndarray:
    base = texture.wood(canvas) * 1.2
    return blend(base, (0.03, 0.02, 0.01), 1 - band(canvas.x % 0.45, 0.01, 0.44) + 0 * canvas.y)


def _masonry(canvas: Canvas) -> np.ndarray:
    row = np.floor(canvas.y / 0.2)
    x = (canvas.x + 0.2 * (row % 2)) % 0.4
    base = weathered(canvas, canvas.colour((0.45, 0.30, 0.20)), 0.12)
    return blend(base, (0.55, 0.53, 0.5), 1 - band(x, 0.008, 0.392) * band(canvas.y % 0.2, 0.008, 0.192))


TILE = Material(_tile, texel_m=0.005)
SPEAKER = Material(_speaker, texel_m=0.005)


def _panel(material: Material, cue: bool = False) -> Part:
    part = Part(cue=cue)
    part.quad((0, PANEL, 0), (PANEL, 0, 0), (0, -PANEL, 0), material)
    return part


def _lamp() -> Part:
    part = Part()
    x0, x1, y0, y1, low, high = 0.0, 1.2, 0.18, 0.42, -0.51, -0.45
    body = plain((0.45, 0.45, 0.44), gloss=0.2)
    part.box((x0, y0, low), (x1, y1, high), body, "xXyY")
    part.quad((x0, y1, low), (x1 - x0, 0, 0), (0, y0 - y1, 0), Material(_diffuser, emission=14.0, glare=0.14))
    part.quad((x0, y0, high), (x1 - x0, 0, 0), (0, y1 - y0, 0), texture.lit((1.0, 0.95, 0.85), 4.0))
    for x in (0.2, 1.0):
        part.beam((x, 0.3, high), (x, 0.3, 0), 0.008, body, 4)
        part.box((x - 0.04, 0.26, -0.02), (x + 0.04, 0.34, 0), body, "xXyYz")
    return part


def _hall() -> Part:
    part = Part()
    part.quad((0, 0, 0), (LENGTH, 0, 0), (0, BREADTH, 0), Material(_floor, texel_m=0.05))
    return part


def _walls() -> Part:
    part = Part(cue=True)
    part.quad((LENGTH, 0, 0), (-LENGTH, 0, 0), (0, 0, HEIGHT), Material(texture.plaster, texel_m=0.012))
    part.quad((0, BREADTH, 0), (LENGTH, 0, 0), (0, 0, HEIGHT), plain((0.16, 0.25, 0.38)))
    part.quad((0, 0, 0), (0, BREADTH, 0), (0, 0, HEIGHT), Material(_panelled, gloss=0.3, texel_m=0.012))
    part.quad((LENGTH, BREADTH, 0), (0, -BREADTH, 0), (0, 0, HEIGHT), Material(_masonry, texel_m=0.012))
    trim = plain((0.7, 0.7, 0.67))
    low, size = HEIGHT - 0.1, 0.07
    part.box((0, 0, low), (LENGTH, size, HEIGHT), trim, "Yz")
    part.box((0, BREADTH - size, low), (LENGTH, BREADTH, HEIGHT), trim, "yz")
    part.box((0, 0, low), (size, BREADTH, HEIGHT), trim, "Xz")
    part.box((LENGTH - size, 0, low), (LENGTH, BREADTH, HEIGHT), trim, "xz")
    return part


def _outlet() -> Part:
    part = _panel(Material(_outlet_art, texel_m=0.005), cue=True)
    part.box((0.03, 0.03, -0.03), (0.57, 0.57, 0.0), plain((0.6, 0.6, 0.58)), "xXyY")
    part.quad((0.03, 0.57, -0.03), (0.54, 0, 0), (0, -0.54, 0), Material(_outlet_art, texel_m=0.005))
    return part


def _hole() -> Part:
    part = Part(cue=True)
    dark, depth = plain((0.10, 0.095, 0.09)), 0.6
    part.quad((0, PANEL, depth), (PANEL, 0, 0), (0, -PANEL, 0), plain((0.16, 0.15, 0.14), amount=0.2))
    part.quad((0, 0, 0), (0, PANEL, 0), (0, 0, depth), dark)
    part.quad((PANEL, PANEL, 0), (0, -PANEL, 0), (0, 0, depth), dark)
    part.quad((PANEL, 0, 0), (-PANEL, 0, 0), (0, 0, depth), dark)
    part.quad((0, PANEL, 0), (PANEL, 0, 0), (0, 0, depth), dark)
    part.beam((0, 0.18, 0.3), (PANEL, 0.18, 0.3), 0.06, Material(texture.brushed), 10)
    part.beam((0.42, 0, 0.2), (0.42, PANEL, 0.2), 0.025, plain((0.5, 0.08, 0.05)), 8)
    part.beam((0.2, 0.4, 0.4), (0.28, 0.42, -0.35), 0.012, plain((0.7, 0.55, 0.05)), 6)
    return part


def _stains() -> Part:
    part = Part(cue=True)
    for ix, iy in STAIN_AT:
        corner = (ix * PANEL, (iy + 1) * PANEL, HEIGHT - 0.002)
        part.quad(corner, (PANEL, 0, 0), (0, -PANEL, 0), Material(_stain, texel_m=0.005))
    return part


def _projector() -> Part:
    part = Part(cue=True)
    black, white = plain((0.05, 0.05, 0.055), gloss=0.4), plain((0.62, 0.62, 0.6), gloss=0.2)
    part.beam((0, 0, 0), (0, 0, -0.35), 0.03, white, 8)
    part.box((-0.28, -0.22, -0.50), (0.28, 0.22, -0.35), white)
    for k in range(5):
        part.box((-0.24, -0.18 + 0.045 * k, -0.503), (-0.02, -0.155 + 0.045 * k, -0.50), black)
    part.box((0.06, -0.10, -0.505), (0.20, 0.10, -0.50), plain((0.05, 0.12, 0.35), gloss=0.3))
    part.beam((0.28, 0.06, -0.43), (0.36, 0.06, -0.43), 0.06, black, 10)
    part.box((-0.12, -0.12, -0.02), (0.12, 0.12, 0), white)
    return part


def _exit_sign() -> Part:
    part = Part(cue=True)
    art = Material(_sign_art, emission=2.2, texel_m=0.005)
    frame = plain((0.6, 0.6, 0.58))
    part.quad((0.28, 0, -0.42), (-0.56, 0, 0), (0, 0.16, 0.26), art)
    part.quad((-0.28, 0, -0.42), (0.56, 0, 0), (0, -0.16, 0.26), art)
    part.box((-0.3, -0.17, -0.16), (0.3, 0.17, -0.13), frame)
    for x in (-0.22, 0.22):
        part.beam((x, 0, 0), (x, 0, -0.13), 0.012, frame, 6)
    return part


def roll_through_hall(duration_s: float, *, margin_m: float, rng: np.random.Generator) -> Poses:
    """A cart wandering about the hall: world_from_base every 20 ms, x forward, z up, on the floor.

    It heads for one random place after another, turning no tighter than a cart can.
    """
    steps = int(np.ceil(duration_s / STEP_S)) + 1
    low = np.full(2, margin_m)
    high = np.array([LENGTH, BREADTH]) - margin_m
    position, heading, rate, speed = rng.uniform(low, high), rng.uniform(-np.pi, np.pi), 0.0, 0.6
    goal = rng.uniform(low, high)
    xy, yaw = np.empty((steps, 2)), np.empty(steps)
    pace = 0.6 + 0.08 * wander(steps, 5.0, rng)
    for i in range(steps):
        if np.hypot(*(goal - position)) < 0.7:
            goal = rng.uniform(low, high)
        to_goal = np.arctan2(goal[1] - position[1], goal[0] - position[0]) - heading
        to_goal = (to_goal + np.pi) % (2 * np.pi) - np.pi
        rate += (min(max(1.2 * to_goal, -0.75), 0.75) - rate) * STEP_S / 0.4
        speed += (pace[i] * (1 - 0.55 * min(1.0, abs(rate) / 0.75)) - speed) * STEP_S / 0.5
        heading += rate * STEP_S
        position = position + speed * STEP_S * np.array([np.cos(heading), np.sin(heading)])
        position = np.minimum(np.maximum(position, 0.5 * low), high + 0.5 * low)  # in half the time of np.clip
        xy[i], yaw[i] = position, heading
    tilt = 0.006 * np.stack([wander(steps, 0.6, rng), wander(steps, 0.6, rng)])
    height = 0.002 * wander(steps, 0.4, rng)
    return Poses(rotations(yaw, tilt[0], tilt[1]), np.column_stack([xy, height]))


def _placements() -> list[Placement]:
    across, along = round(BREADTH / PANEL), round(LENGTH / PANEL)
    middle = (along // CELL[0] // 2) * (across // CELL[1]) + across // CELL[1] // 2
    placed = []
    for place in np.ndindex(CELL):
        cells = [(ix, iy) for ix in range(place[0], along, CELL[0]) for iy in range(place[1], across, CELL[1])]
        copies = [cell for cell in cells if cell not in (OUTLET_AT, HOLE_AT)]
        paint = SPEAKER if place == SPEAKER_AT else TILE
        placed.append(Placement(_panel(paint), _offsets(copies), lit_at=copies.index(cells[middle])))
        if place == LAMP_AT:
            placed.append(Placement(_lamp(), _offsets(cells), lit_at=middle))
    return [
        *placed,
        Placement(_hall(), np.zeros((1, 3))),
        Placement(_walls(), np.zeros((1, 3))),
        Placement(_outlet(), _offsets([OUTLET_AT])),
        Placement(_hole(), _offsets([HOLE_AT])),
        Placement(_stains(), np.zeros((1, 3))),
        Placement(_projector(), np.array([[*PROJECTOR_AT, HEIGHT]])),
        Placement(_exit_sign(), np.array([[*SIGN_AT, HEIGHT]])),
    ]


def _offsets(panels: list[tuple[int, int]]) -> np.ndarray:
    corner = np.array(panels, float) * PANEL
    return np.column_stack([corner, np.full(len(corner), HEIGHT)])


SCENE = Scene(
    name="ceiling",
    seed_numbers=(1,),
    placements=lambda split, seed: _placements(),
    path=lambda duration_s, split, seed, rng: roll_through_hall(
        duration_s, margin_m=1.0 if split == "train" else 1.8, rng=rng
    ),
    field_of_view_deg=64.0,
    base_from_camera=mounted_upward((0.12, -0.04, 0.9)),
    has_cues=True,
)
