"""A stairwell of six floors, four of which look the same."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64
from scipy.ndimage import gaussian_filter1d

from filtering.se3 import Poses
from sequences.paths import STEP_S, eased, eased_angle, rotations, wander
from sequences.rendering import texture
from sequences.rendering.mesh import Part, Placement
from sequences.rendering.texture import Canvas, Material, band, blend, inside, plain, rim, weathered
from sequences.scenes.lines import distances_along, points_at, resampled
from sequences.scenes.scene import HELMET, Scene
from sequences.scenes.stairwell import (
    ACROSS,
    FAR,
    FLIGHT,
    FLOOR_HEIGHT,
    FRAME,
    HALF,
    INNER_B,
    LANDING,
    NUM_FLOORS,
    POSTER_FLOOR,
    SLAB,
    TERRAZZO,
    TOP_HEIGHT,
    WALL_LANDING,
    WALL_TOP,
    WHITE,
    WIDTH,
    flights,
    landing,
    undersides,
)


def _poster_art(canvas: Canvas) -> np.ndarray:
    x, y = canvas.x / canvas.width_m, canvas.y / canvas.height_m
    base = canvas.colour((0.95, 0.42, 0.06)) * (0.7 + 0.45 * (1 - y))[..., None]
    sun = np.hypot(canvas.x - 0.62 * canvas.width_m, canvas.y - 0.66 * canvas.height_m)
    base = blend(base, (1.0, 0.86, 0.25), 1 - texture.step(sun, 0.17))
    base = blend(base, (0.40, 0.03, 0.16), band(y, 0.0, 1.0) * (y < 0.52 + 0.07 * np.sin(7 * x + 1)))
    base = blend(base, (0.02, 0.16, 0.42), (y < 0.36 + 0.03 * np.sin(13 * x)) * 1.0)
    base = blend(base, (0.03, 0.42, 0.58), (y < 0.26 + 0.015 * np.sin(31 * x)) * 1.0)
    letters = (np.sin(x * 58) > -0.25) * band(x, 0.14, 0.86) * band(y, 0.85, 0.93)
    base = blend(base, (0.02, 0.02, 0.08), letters)
    frame = 1 - band(x, 0.035, 0.965) * band(y, 0.03, 0.97)
    return blend(base, (0.92, 0.90, 0.84), frame)


def _notices(canvas: Canvas) -> np.ndarray:
    base = weathered(canvas, canvas.colour((0.36, 0.22, 0.11)), 0.12)
    sheets = [
        (0.06, 0.40, 0.27, 0.70, (0.85, 0.85, 0.82)),
        (0.32, 0.45, 0.53, 0.74, (0.9, 0.75, 0.12)),
        (0.58, 0.36, 0.79, 0.66, (0.85, 0.85, 0.85)),
        (0.84, 0.42, 1.05, 0.72, (0.75, 0.15, 0.12)),
        (0.10, 0.08, 0.31, 0.34, (0.35, 0.6, 0.8)),
        (0.45, 0.09, 0.66, 0.38, (0.85, 0.85, 0.8)),
        (0.80, 0.08, 1.05, 0.30, (0.4, 0.7, 0.3)),
    ]
    for x0, y0, x1, y1, rgb in sheets:
        sheet = inside(canvas, x0, y0, x1, y1)
        base = blend(base, rgb, sheet)
        lines = (np.sin(canvas.y * 2 * np.pi / 0.03) > 0.2) & (canvas.noise(0.03, 0.015) > -0.4)
        base = blend(base, (0.08, 0.08, 0.1), inside(canvas, x0 + 0.02, y0 + 0.03, x1 - 0.02, y1 - 0.06) * lines * 0.8)
    return blend(base, (0.5, 0.5, 0.48), rim(canvas, 0.025))


def _letter_boxes(canvas: Canvas) -> np.ndarray:
    base = texture.brushed(canvas)
    x, y = canvas.x % 0.3, canvas.y % 0.2
    gaps = 1 - band(x, 0.008, 0.292) * band(y, 0.008, 0.192)
    base = blend(base, (0.03, 0.03, 0.03), gaps)
    base = blend(base, (0.04, 0.04, 0.04), band(x, 0.05, 0.25) * band(y, 0.135, 0.16))
    return blend(base, (0.85, 0.85, 0.8), band(x, 0.06, 0.16) * band(y, 0.05, 0.085))


def _street(canvas: Canvas) -> np.ndarray:
    height = canvas.y
    base = canvas.colour((0.75, 0.87, 1.0))
    facade = np.array([0.55, 0.40, 0.28]) * np.clip(1 + 0.1 * canvas.noise(0.1), 0, 2)[..., None]
    base = blend(base, facade.astype(np.float32), 1 - texture.step(height + 0 * canvas.x, 1.7, 0.06))
    windows = band(canvas.x % 0.36, 0.1, 0.26, 0.03) * band(height % 0.62, 0.12, 0.45, 0.03) * band(height, 0.6, 1.7)
    base = blend(base, (0.12, 0.14, 0.17), windows)
    return blend(base, (0.42, 0.42, 0.43), 1 - texture.step(height + 0 * canvas.x, 0.55, 0.06))


def _mat(canvas: Canvas) -> np.ndarray:
    base = canvas.colour((0.23, 0.035, 0.03)) * np.clip(1 + 0.25 * canvas.noise(0.012), 0.2, 2)[..., None]
    return blend(base, (0.03, 0.03, 0.03), rim(canvas, 0.05))


def _brick(canvas: Canvas) -> np.ndarray:
    row = np.floor(canvas.y / 0.075)
    x = (canvas.x + 0.12 * (row % 2)) % 0.24
    joint = 1 - band(x, 0.01, 0.23) * band(canvas.y % 0.075, 0.01, 0.065)
    tone = 1 + 0.25 * np.sin(row * 12.9 + np.floor((canvas.x + 0.12 * (row % 2)) / 0.24) * 78.2)
    base = canvas.colour((0.36, 0.13, 0.075)) * (tone * (1 + 0.1 * canvas.noise(0.02)))[..., None].astype(np.float32)
    return blend(base, (0.45, 0.42, 0.38), joint)


def _cloudy(canvas: Canvas) -> np.ndarray:
    return blend(canvas.colour((0.55, 0.75, 1.0)), (1.0, 1.0, 1.0), 0.5 + 0.4 * canvas.noise(0.4))


def _entrance() -> Part:
    part = Part(cue=True)
    part.quad((0.02, 0.55, 0), (0, 1.5, 0), (0, 0, 2.35), Material(_street, emission=6.0, glare=0.4))
    green = plain((0.03, 0.10, 0.07), gloss=0.4)
    for y in (0.47, 1.255, 2.05):
        part.box((0, y, 0), (0.09, y + 0.09, 2.45), green, "XyY")
    for z, high in ((0.0, 0.28), (1.0, 1.08), (2.3, 2.45)):
        part.box((0, 0.5, z), (0.085, 2.1, high), green, "XzZ")
    part.quad((0.12, 0.6, 0.008), (1.0, 0, 0), (0, 1.4, 0), Material(_mat))
    part.box((0.35, 0, 0.75), (1.55, 0.16, 1.75), Material(_letter_boxes, gloss=0.3, texel_m=0.005), "xXYzZ")
    part.box((0.25, ACROSS - 0.03, 1.0), (1.4, ACROSS, 1.8), Material(_notices, texel_m=0.005), "xXyzZ")
    part.quad((LANDING, ACROSS, 0), (0, -WIDTH - 0.02, 0), (0, 0, FLOOR_HEIGHT - SLAB), WALL_LANDING)
    part.box((LANDING - 0.03, 1.62, 0), (LANDING, 2.42, 1.95), plain((0.13, 0.17, 0.22), gloss=0.3), "xyYZ")
    return part


def _cellar() -> Part:
    part = Part()
    part.quad((LANDING, INNER_B + 0.02, 0), (FLIGHT, 0, -HALF), (0, 0, FLOOR_HEIGHT - SLAB), WHITE)
    part.quad((LANDING, 0, 0), (FAR - LANDING, 0, 0), (0, ACROSS, 0), TERRAZZO)
    part.quad((FAR, ACROSS, 0), (0, -ACROSS, 0), (0, 0, HALF), WHITE)
    return part


def _poster() -> Part:
    part = Part(cue=True)
    part.box((0.0, 1.46, 0.85), (0.02, 2.48, 2.3), Material(_poster_art, gloss=0.15, texel_m=0.004), "XyYzZ")
    return part


def _top() -> Part:
    part = Part(cue=True)
    bricks = Material(_brick)
    part.box((LANDING, 0, -0.25), (LANDING + 0.09, WIDTH + 0.08, TOP_HEIGHT), bricks)
    for y in (0.32, 0.72):
        part.beam((LANDING - 0.12, y, 0.3), (LANDING - 0.12, y, TOP_HEIGHT), 0.02, plain((0.6, 0.45, 0.03)), 6)
    for k in range(8):
        z = 0.45 + 0.28 * k
        part.beam((LANDING - 0.12, 0.32, z), (LANDING - 0.12, 0.72, z), 0.014, plain((0.6, 0.45, 0.03)), 6)
    x0, x1, y0, y1 = 2.2, 3.6, 0.6, 2.0
    for a, b, c, d in ((LANDING, x0, 0, ACROSS), (x1, FAR, 0, ACROSS), (x0, x1, 0, y0), (x0, x1, y1, ACROSS)):
        part.quad((a, d, TOP_HEIGHT), (b - a, 0, 0), (0, c - d, 0), WHITE)
    high = TOP_HEIGHT + 0.35
    part.quad((x0, y1, high), (x1 - x0, 0, 0), (0, y0 - y1, 0), Material(_cloudy, emission=2.5))
    part.quad((x1, y0, TOP_HEIGHT), (x0 - x1, 0, 0), (0, 0, 0.35), WHITE)
    part.quad((x0, y1, TOP_HEIGHT), (x1 - x0, 0, 0), (0, 0, 0.35), WHITE)
    part.quad((x0, y0, TOP_HEIGHT), (0, y1 - y0, 0), (0, 0, 0.35), WHITE)
    part.quad((x1, y1, TOP_HEIGHT), (0, y0 - y1, 0), (0, 0, 0.35), WHITE)
    part.box((2.87, y0, high - 0.05), (2.93, y1, high), FRAME, "xXz")
    part.box((x0, 1.27, high - 0.05), (x1, 1.33, high), FRAME, "yYz")
    return part


def _roof_walls() -> Part:
    part = Part()
    part.quad((FAR, 0, 0), (LANDING - FAR, 0, 0), (0, 0, TOP_HEIGHT), WHITE)
    part.quad((LANDING, ACROSS, 0), (FAR - LANDING, 0, 0), (0, 0, TOP_HEIGHT), WALL_TOP)
    bottom = HALF - SLAB
    part.quad((FAR, ACROSS, bottom), (0, -ACROSS, 0), (0, 0, TOP_HEIGHT - bottom), WHITE)
    return part


def walk_stairs(duration_s: float, *, rng: np.random.Generator) -> Poses:
    """A person going up and down the stairwell: world_from_base every 20 ms, x forward, z up, at eye height.

    Starts anywhere, either way; pauses, looks about, now and then turns round; sways and bobs with every step.
    """
    line = _stair_line()
    length = float(distances_along(line)[-1])
    steps = int(np.ceil(duration_s / STEP_S)) + 1
    place = np.empty(steps)
    walking = np.empty(steps)
    s, way, speed, pause = rng.uniform(0, length), rng.choice([-1.0, 1.0]), 0.0, 0.0
    pace = rng.uniform(0.55, 0.75)
    chance = rng.random((steps, 2))
    ways = np.empty(steps)
    for i in range(steps):
        if (way > 0 and s > length - 0.25) or (way < 0 and s < 0.25) or (pause <= 0 and chance[i, 0] < STEP_S / 45):
            way, pause = -way, 0.8
        elif pause <= 0 and chance[i, 1] < STEP_S / 20:
            pause = 0.6 + 2.0 * chance[i, 0]
        pause -= STEP_S
        speed += ((0.0 if pause > 0 else way * pace) - speed) * STEP_S / 0.3
        s = min(max(s + speed * STEP_S, 0.0), length)
        place[i], walking[i], ways[i] = s, abs(speed), way

    def at(distance: np.ndarray) -> np.ndarray:
        return points_at(line, np.clip(distance, 0, length))

    here = at(place)
    tangent = at(place + 0.1) - at(place - 0.1)
    side = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1) / (np.linalg.norm(tangent[:, :2], axis=1)[:, None] + 1e-9)
    ahead = at(place + 0.45 * ways) - at(place - 0.2 * ways)
    heading = eased_angle(np.arctan2(ahead[:, 1], ahead[:, 0]), time_s=0.35, max_rate=2.4)
    phase = np.pi * np.cumsum(walking) * STEP_S / 0.33 + rng.uniform(0, 2 * np.pi)  # π a step
    stride = np.clip(walking / 0.5, 0, 1)
    glance = (
        wander(steps, 1.6, rng) * 0.22
        + eased(np.clip(np.abs(wander(steps, 2.5, rng)) - 1.2, 0, 1), 0.3) * rng.choice([-1, 1]) * 0.9
    )
    yaw = heading + glance + 0.02 * stride * np.sin(phase + 0.5)
    pitch = 0.06 * wander(steps, 2.0, rng) + 0.012 * stride * np.sin(2 * phase + 1.0)
    climb = ahead[:, 2] / (np.linalg.norm(ahead, axis=1) + 1e-9)
    pitch += eased(np.where(climb < 0, -0.45, -0.1) * climb, 0.4)  # people watch the steps, above all going down
    roll = 0.012 * wander(steps, 1.0, rng) + 0.018 * stride * np.sin(phase)
    here[:, :2] += side * (0.07 * np.clip(wander(steps, 4.0, rng), -2, 2) + 0.022 * stride * np.sin(phase))[:, None]
    here[:, 2] += 1.5 + 0.02 * stride * np.cos(2 * phase) + 0.02 * wander(steps, 5.0, rng)
    return Poses(rotations(yaw, pitch, roll), here)


def _stair_line() -> Float64[np.ndarray, "n 3"]:
    """The line of a person's feet, from the entrance to the top."""
    low_y, high_y = WIDTH / 2, ACROSS - WIDTH / 2
    radius, middle = (high_y - low_y) / 2, ACROSS / 2
    near, far = LANDING, LANDING + FLIGHT
    turn = np.linspace(-np.pi / 2, np.pi / 2, 25)
    points = [(0.75, middle - 0.4, 0.0)]
    for level in range(NUM_FLOORS - 1):
        z = level * FLOOR_HEIGHT
        points += [(near, low_y, z), (far, low_y, z + HALF)]
        points += [(far + 0.06 + radius * np.cos(a), middle + radius * np.sin(a), z + HALF) for a in turn]
        points += [(far, high_y, z + HALF), (near, high_y, z + FLOOR_HEIGHT)]
        if level < NUM_FLOORS - 2:
            points += [(near - 0.1 - radius * np.cos(a), middle - radius * np.sin(a), z + FLOOR_HEIGHT) for a in turn]
    points.append((0.75, middle + 0.4, (NUM_FLOORS - 1) * FLOOR_HEIGHT))
    return gaussian_filter1d(resampled(np.array(points), 0.02), 8, axis=0, mode="nearest")


def _placements() -> list[Placement]:
    floors = np.array([[0.0, 0.0, level * FLOOR_HEIGHT] for level in range(NUM_FLOORS)])
    top = floors[-1:]
    return [
        Placement(flights(), floors[:-1], lit_at=2),
        Placement(landing(), floors[1:-1], lit_at=1),
        Placement(landing(), top),
        Placement(landing(door=False), floors[:1]),
        Placement(_entrance(), floors[:1]),
        Placement(_cellar(), floors[:1]),
        Placement(_poster(), floors[POSTER_FLOOR : POSTER_FLOOR + 1]),
        Placement(_top(), top),
        Placement(_roof_walls(), top),
        Placement(undersides(), floors[:-1], lit_at=2),
    ]


SCENE = Scene(
    name="staircase",
    seed_numbers=(0,),
    placements=lambda split, seed: _placements(),
    path=lambda duration_s, split, seed, rng: walk_stairs(duration_s, rng=rng),
    field_of_view_deg=77.0,
    base_from_camera=HELMET,
    has_cues=True,
)
