"""Two floors alike, each a long corridor with a frame and two doors every 3 m, and a lamp every 5 m.

All of this repeats after 15 m, with the colours of the doors. The place along the corridor shows in the colour of the
walls, which changes slowly, in dirt and in notice boards, all the same on both floors. One end has a window, the other
a door. The floor shows at the ends alone, on painted walls.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from filtering.se3 import Poses
from sequences.paths import STEP_S, eased, rotations, wander
from sequences.rendering import texture
from sequences.rendering.mesh import Part, Placement
from sequences.rendering.texture import Canvas, Material, band, blend, inside, plain, rim, weathered
from sequences.scenes.scene import HELMET, Scene

LENGTH, WIDTH, HEIGHT = 75.0, 2.4, 2.6  # metres, x, y, z
NUM_FLOORS, FLOOR_HEIGHT = 2, 3.2
BAY, LAMP_SPACING = 3.0, 5.0  # from frame to frame, from lamp to lamp
REPEAT = 15.0  # after which bays and lamps are placed alike again
NUM_BAYS, NUM_LAMPS = round(LENGTH / BAY), round(LENGTH / LAMP_SPACING)
DOOR_WIDTH, DOOR_HEIGHT = 0.9, 2.05
DOORS_AT = (0.45, 1.65)  # from the frame, in the wall at low y and in that at high y
FRAME_DEPTH, FRAME_WIDTH = 0.06, 0.2
DOOR_STAINS = ((1.0, 1.0, 1.0), (0.28, 0.45, 0.75), (1.5, 1.7, 2.6), (0.65, 0.22, 0.25), (0.35, 0.75, 0.55))
MURAL = 2.4  # metres wide
BOARDS = (  # bay, whether in the wall at high y, colour
    (3, False, (0.45, 0.06, 0.05)),
    (6, True, (0.06, 0.16, 0.42)),
    (9, False, (0.62, 0.45, 0.05)),
    (11, True, (0.07, 0.30, 0.12)),
    (14, False, (0.32, 0.10, 0.36)),
    (17, True, (0.55, 0.23, 0.05)),
    (20, False, (0.05, 0.32, 0.36)),
    (22, True, (0.30, 0.30, 0.30)),
)


def _tint(x: np.ndarray, high_y: bool) -> np.ndarray:
    """The colour of a wall at places x in metres, as a factor (..., 3)."""
    phase = np.random.default_rng([5, high_y]).uniform(0, 2 * np.pi, (3, 2))
    waves = [0.7 * np.sin(2 * np.pi * x / 53.0 + a) + 0.5 * np.sin(2 * np.pi * x / 19.0 + b) for a, b in phase]
    return np.exp(0.55 * np.stack(waves, axis=-1)).astype(np.float32)


def _wall(canvas: Canvas, bay: int, high_y: bool) -> np.ndarray:
    """White plaster above oil paint, a bumper rail between: alike in all bays but for colour and dirt."""
    shared = replace(canvas, rng=np.random.default_rng([6, high_y]))
    own = replace(canvas, rng=np.random.default_rng([7, bay, high_y]))
    factor = _tint(np.broadcast_to(canvas.point(0), canvas.shape), high_y)
    z = canvas.point(2) + 0 * canvas.x
    base = texture.plaster(shared) * factor ** np.float32(0.3)
    oil = weathered(shared, shared.colour((0.30, 0.32, 0.30)), 0.05) * factor
    base = blend(oil, base, texture.step(z, 1.0))
    dirt = 0.35 * np.clip(own.noise(0.5, 0.3) - 0.9, 0, 1) + 0.7 * np.clip(own.noise(0.2, 0.02) - 1.9, 0, 1)
    base = blend(base, (0.10, 0.09, 0.08), dirt * band(z, 0.1, 1.6, 0.5))
    base = blend(base, (0.16, 0.12, 0.09), band(z, 0.93, 1.05))
    return blend(base, (0.07, 0.07, 0.07), band(z, -0.01, 0.1))


def _linoleum(canvas: Canvas) -> np.ndarray:
    tile = (np.floor(canvas.x / 0.5) + np.floor(canvas.y / 0.4)) % 2
    base = weathered(canvas, canvas.colour((0.25, 0.27, 0.27)), 0.08) * (1 + 0.25 * tile)[..., None]
    joint = 1 - band(canvas.x % 0.5, 0.006, 0.494) * band(canvas.y % 0.4, 0.006, 0.394)
    base = blend(base, (0.08, 0.08, 0.08), 0.6 * joint)
    return blend(base, (0.09, 0.10, 0.11), 1 - band(canvas.y, 0.2, WIDTH - 0.2) + 0 * canvas.x)


def _panels(canvas: Canvas) -> np.ndarray:
    base = weathered(canvas, canvas.colour((0.62, 0.61, 0.58)), 0.03)
    grid = 1 - band(canvas.x % 0.625, 0.012, 0.613) * band(canvas.y % 0.6, 0.012, 0.588)
    return blend(base, (0.35, 0.35, 0.34), grid)


def _sheets(canvas: Canvas, colour: tuple[float, float, float]) -> np.ndarray:
    base = weathered(canvas, canvas.colour(colour), 0.06)
    for x0, y0, x1, y1 in ((0.08, 0.38, 0.29, 0.68), (0.36, 0.42, 0.57, 0.70), (0.70, 0.30, 1.0, 0.52)):
        lines = inside(canvas, x0 + 0.02, y0 + 0.03, x1 - 0.02, y1 - 0.05) * (np.sin(canvas.y * 2 * np.pi / 0.04) > 0.2)
        base = blend(base, (0.75, 0.75, 0.72), inside(canvas, x0, y0, x1, y1))
        base = blend(base, (0.12, 0.12, 0.14), 0.7 * lines)
    return blend(base, (0.5, 0.5, 0.48), rim(canvas, 0.03))


def _mural(canvas: Canvas, which: int) -> np.ndarray:
    x, y = canvas.x + 0 * canvas.y, canvas.y + 0 * canvas.x
    if which == 0:  # blue waves under a white sky
        base = canvas.colour((0.75, 0.78, 0.80))
        for k, rgb in enumerate(((0.10, 0.35, 0.62), (0.04, 0.18, 0.45), (0.02, 0.07, 0.25))):
            base = blend(base, rgb, 1 - texture.step(y - 0.1 * np.sin(2.5 * x + 2 * k), 1.2 - 0.4 * k))
        return base
    if which == 1:  # orange suns on yellow
        radius = np.hypot(x % 0.8 - 0.4, y % 0.8 - 0.4)
        return blend(canvas.colour((0.75, 0.60, 0.08)), (0.70, 0.15, 0.03), 1 - texture.step(radius, 0.28))
    if which == 2:  # slanting stripes, red and white
        return blend(canvas.colour((0.70, 0.68, 0.66)), (0.50, 0.03, 0.05), band((x + y) % 0.7, 0.0, 0.35))
    squares = (np.floor(x / 0.4) + np.floor(y / 0.4)) % 2  # black and green
    return blend(canvas.colour((0.03, 0.04, 0.03)), (0.12, 0.50, 0.10), squares)


def _sign_art(canvas: Canvas) -> np.ndarray:
    arrow = inside(canvas, 0.1, 0.08, 0.3, 0.12) + inside(canvas, 0.1, 0.04, 0.15, 0.16)
    return blend(canvas.colour((0.01, 0.42, 0.12)), (0.9, 1.0, 0.92), arrow)


FRAME = plain((0.33, 0.34, 0.36), gloss=0.2)
TRIM = plain((0.50, 0.49, 0.45), gloss=0.2)
METAL = Material(texture.brushed, gloss=0.6)
LAMP = replace(texture.lit((1.0, 0.96, 0.88), 8.0), glare=0.3)
SKY = Material(texture.sky, emission=6.0, glare=0.4)


def _shell() -> Part:
    part, middle = Part(), LAMP_SPACING / 2
    part.quad((0, 0, 0), (LAMP_SPACING, 0, 0), (0, WIDTH, 0), Material(_linoleum, gloss=0.35, texel_m=0.01))
    part.quad((0, WIDTH, HEIGHT), (LAMP_SPACING, 0, 0), (0, -WIDTH, 0), Material(_panels, texel_m=0.012))
    low, high = (middle - 0.6, WIDTH / 2 - 0.14, HEIGHT - 0.1), (middle + 0.6, WIDTH / 2 + 0.14, HEIGHT)
    part.box(low, high, LAMP, "z")
    part.box(low, high, plain((0.6, 0.6, 0.58)), "xXyY")
    return part


def _quad_on_wall(
    part: Part, x0: float, x1: float, low: float, high: float, depth: float, high_y: bool, paint: Material
) -> None:
    if high_y:
        part.quad((x0, WIDTH - depth, low), (x1 - x0, 0, 0), (0, 0, high - low), paint)
    else:
        part.quad((x1, depth, low), (x0 - x1, 0, 0), (0, 0, high - low), paint)


def _box_on_wall(
    part: Part, x0: float, x1: float, low: float, high: float, depth: float, high_y: bool, paint: Material
) -> None:
    y0, y1 = (WIDTH - depth, WIDTH) if high_y else (0.0, depth)
    part.box((x0, y0, low), (x1, y1, high), paint, "xXzZ" + ("y" if high_y else "Y"))


def _walls(bay: int) -> Part:
    part = Part()
    for high_y in (False, True):
        paint = Material(lambda canvas, high_y=high_y: _wall(canvas, bay, high_y), gloss=0.12, texel_m=0.012)
        _quad_on_wall(part, bay * BAY, (bay + 1) * BAY, 0.0, HEIGHT, 0.0, high_y, paint)
    return part


def _frame(part: Part | None = None) -> Part:
    part, half = part or Part(), FRAME_WIDTH / 2
    for high_y in (False, True):
        _box_on_wall(part, -half, half, 0.0, HEIGHT, FRAME_DEPTH, high_y, FRAME)
    part.box((-half, FRAME_DEPTH, HEIGHT - FRAME_DEPTH), (half, WIDTH - FRAME_DEPTH, HEIGHT), FRAME, "xXz")
    return part


def _bay(stain: tuple[float, float, float]) -> Part:
    part = _frame()
    door = Material(lambda canvas: texture.door(canvas) * np.array(stain, np.float32))
    for high_y, x0 in zip((False, True), DOORS_AT, strict=True):
        x1, trim, knob = x0 + DOOR_WIDTH, 0.07, x0 + (DOOR_WIDTH - 0.12 if high_y else 0.06)
        _quad_on_wall(part, x0, x1, 0.0, DOOR_HEIGHT, 0.012, high_y, door)
        _box_on_wall(part, x0 - trim, x0, 0.0, DOOR_HEIGHT + trim, 0.035, high_y, TRIM)
        _box_on_wall(part, x1, x1 + trim, 0.0, DOOR_HEIGHT + trim, 0.035, high_y, TRIM)
        _box_on_wall(part, x0, x1, DOOR_HEIGHT, DOOR_HEIGHT + trim, 0.035, high_y, TRIM)
        _box_on_wall(part, knob, knob + 0.06, 0.95, 1.15, 0.05, high_y, METAL)
        _box_on_wall(part, x1 + 0.12, x1 + 0.27, 1.45, 1.55, 0.012, high_y, METAL)
    return part


def _board(bay: int, high_y: bool, colour: tuple[float, float, float]) -> Part:
    part, x0 = Part(), bay * BAY + (0.3 if high_y else 1.75)
    paint = Material(lambda canvas: _sheets(canvas, colour), texel_m=0.008)
    _box_on_wall(part, x0, x0 + 1.08, 1.15, 1.95, 0.025, high_y, paint)
    return part


def _window_end() -> Part:
    part, y0, y1, z0, z1, deep = Part(), 0.4, 2.0, 0.9, 2.1, -0.2
    white = Material(texture.plaster)
    for low, high, a, b in ((0, z0, 0, WIDTH), (z1, HEIGHT, 0, WIDTH), (z0, z1, 0, y0), (z0, z1, y1, WIDTH)):
        part.quad((0, a, low), (0, b - a, 0), (0, 0, high - low), white)
    part.quad((deep, y0, z0), (0, y1 - y0, 0), (0, 0, z1 - z0), SKY)
    part.quad((deep, y0, z0), (-deep, 0, 0), (0, y1 - y0, 0), TRIM)
    part.quad((deep, y1, z1), (-deep, 0, 0), (0, y0 - y1, 0), white)
    part.quad((0, y0, z0), (deep, 0, 0), (0, 0, z1 - z0), white)
    part.quad((deep, y1, z0), (-deep, 0, 0), (0, 0, z1 - z0), white)
    for y in (y0, (y0 + y1) / 2, y1):
        part.box((deep, y - 0.035, z0), (deep + 0.06, y + 0.035, z1), TRIM, "XyY")
    part.box((0, 0.6, 0.15), (0.1, 1.8, 0.75), Material(texture.radiator, gloss=0.2), "XyYZ")
    return part


def _door_end() -> Part:
    part, x = Part(), LENGTH
    part.quad((x, WIDTH, 0), (0, -WIDTH, 0), (0, 0, HEIGHT), plain((0.30, 0.09, 0.07)))
    part.box((x - 0.03, 0.4, 0), (x, 2.0, 2.1), Material(texture.steel, gloss=0.4), "xyYZ")
    part.box((x - 0.035, 1.19, 0), (x, 1.21, 2.1), plain((0.02, 0.02, 0.02)), "x")
    for y in (0.6, 1.3):
        part.box((x - 0.1, y, 1.0), (x - 0.03, y + 0.5, 1.06), METAL, "xyYzZ")
    part.box((x - 0.06, 1.0, 2.2), (x, 1.4, 2.4), Material(_sign_art, emission=1.5, glare=0.4, texel_m=0.01), "x")
    return part


def _murals(level: int) -> Part:
    part, rim = Part(cue=True), (BAY - MURAL) / 2
    for end, x0 in enumerate((rim, LENGTH - BAY + rim)):
        for high_y in (False, True):
            paint = Material(lambda canvas, end=end: _mural(canvas, 2 * level + end), texel_m=0.01)
            _quad_on_wall(part, x0, x0 + MURAL, 0.5, 2.2, 0.01, high_y, paint)
    return part


def walk_corridor(duration_s: float, *, rng: np.random.Generator) -> Poses:
    """A person walking up and down the corridor of one floor: world_from_base every 20 ms, x forward, z up.

    Starts anywhere on either floor, either way; turns round at the ends and now and then elsewhere, seldom pauses,
    glances to the sides, sways and bobs with every step.
    """
    steps = int(np.ceil(duration_s / STEP_S)) + 1
    low, high = 1.3, LENGTH - 1.3
    level, x, way = rng.integers(NUM_FLOORS), rng.uniform(low, high), rng.choice([-1.0, 1.0])
    heading, speed, pause, pace = 0.0 if way > 0 else np.pi, 0.0, 0.0, rng.uniform(1.1, 1.3)
    chance = rng.random((steps, 3))
    place, walking, headings = np.empty(steps), np.empty(steps), np.empty(steps)
    for i in range(steps):
        at_end = (way > 0 and x > high - 0.3) or (way < 0 and x < low + 0.3)
        if at_end or (pause <= 0 and chance[i, 0] < STEP_S / 120):
            way, pause = -way, 0.9
            heading += np.pi if chance[i, 2] < 0.5 else -np.pi
        elif pause <= 0 and chance[i, 1] < STEP_S / 60:
            pause = 0.6 + 1.5 * chance[i, 2]
        pause -= STEP_S
        speed += ((0.0 if pause > 0 else way * pace) - speed) * STEP_S / 0.3
        x = min(max(x + speed * STEP_S, low - 0.3), high + 0.3)
        place[i], walking[i], headings[i] = x, abs(speed), heading
    phase = np.pi * np.cumsum(walking) * STEP_S / 0.65 + rng.uniform(0, 2 * np.pi)  # π a step
    stride = np.clip(walking / 0.9, 0, 1)
    aside = np.clip(np.abs(wander(steps, 2.5, rng)) - 1.0, 0, 1) * np.sign(wander(steps, 8.0, rng))
    yaw = eased(headings, 0.45) + 0.15 * wander(steps, 1.6, rng) + 0.9 * eased(aside, 0.3)
    yaw += 0.02 * stride * np.sin(phase + 0.5)
    pitch = -0.1 + 0.05 * wander(steps, 2.0, rng) + 0.01 * stride * np.sin(2 * phase + 1.0)
    roll = 0.012 * wander(steps, 1.0, rng) + 0.015 * stride * np.sin(phase)
    across = 0.45 * np.tanh(0.8 * wander(steps, 6.0, rng)) + 0.022 * stride * np.sin(phase)
    up = 1.5 + 0.02 * stride * np.cos(2 * phase) + 0.03 * wander(steps, 5.0, rng)
    position = np.column_stack([place, WIDTH / 2 + across, level * FLOOR_HEIGHT + up])
    return Poses(rotations(yaw, pitch, roll), position)


def _placements() -> list[Placement]:
    floors = np.array([[0.0, 0.0, level * FLOOR_HEIGHT] for level in range(NUM_FLOORS)])

    def along(places: list[float]) -> np.ndarray:
        return (np.array([[place, 0.0, 0.0] for place in places]) + floors[:, None]).reshape(-1, 3)

    lamps = [k * LAMP_SPACING for k in range(NUM_LAMPS)]
    placed = [Placement(_shell(), along(lamps), lit_at=NUM_LAMPS // 2)]
    placed += [Placement(_walls(bay), floors) for bay in range(NUM_BAYS)]
    phases = round(REPEAT / BAY)
    for phase in range(phases):  # bays that lie alike beneath the lamps
        alike = [bay for bay in range(1, NUM_BAYS - 1) if bay % phases == phase]
        placed.append(Placement(_bay(DOOR_STAINS[phase]), along([bay * BAY for bay in alike]), lit_at=len(alike) // 2))
    placed += [Placement(_board(*board), floors) for board in BOARDS]
    placed += [Placement(_frame(), along([LENGTH - BAY])), Placement(_window_end(), floors)]
    placed.append(Placement(_door_end(), floors))
    for level in range(NUM_FLOORS):
        placed.append(Placement(_murals(level), floors[level : level + 1]))
    return placed


SCENE = Scene(
    name="corridor",
    seed_numbers=(4,),
    placements=lambda split, seed: _placements(),
    path=lambda duration_s, split, seed, rng: walk_corridor(duration_s, rng=rng),
    field_of_view_deg=70.0,
    base_from_camera=HELMET,
    has_cues=True,
    storey_height_m=FLOOR_HEIGHT,
)
