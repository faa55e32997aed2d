"""Draws the moving picture of the README: a walk through two rooms that stand on three storeys, and who is where.

    vapor-benchmark real --data DIR --output real --only rooms_copied --seeds 1
    python docs/moving_picture.py DIR real docs/rooms.webp

Images are real (HoloLens, sample data of deep-video-mvs, Düzçeker et al., CVPR 2021, MIT licence), the storeys are
copies of one place, odometry is simulated.
"""

from __future__ import annotations

import argparse
import io
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from filtering.estimate import Mode
from sequences.reader import SequenceReader
from vapor.benchmark.real.row import RowContext
from vapor.benchmark.real.rows import ROWS
from vapor.reporting.drawing import COLORS, FAINT, INK
from vapor.tracking.follow import Followed, follow

_ROW = "rooms_copied"
_STOREYS = 3
_SHOWN = ("single_image", "kalman", "filter")
_NAMES = {"single_image": "single image", "kalman": "Kalman filter", "filter": "vapor-track"}
_MARKS = {"single_image": "X", "kalman": "s"}
_HOLD = 12  # frames at the end
_FRAME_MS = 200
_WIDTH, _HEIGHT, _DPI = 8.4, 3.9, 100
_QUALITY = 62


def localized(context: RowContext, seed: int) -> tuple[Followed, list[np.ndarray]]:
    """A walk of the row with what each method says, and its images."""
    row = next(row for row in ROWS if row.name == _ROW)
    row.prepare(context, seed)
    draw = row.draw(context, seed)
    followed = follow(draw.segment, draw.noise, draw.localizer, rng=np.random.default_rng(seed))
    (walked,) = context.folder("sequences").glob(f"{_ROW}-*.mcap")
    frames = list(SequenceReader(walked))
    places = np.stack([frame.world_from_camera.translation for frame in frames if frame.world_from_camera is not None])
    apart = np.linalg.norm(followed.segment.truth.translation[:, None] - places, axis=2)
    return followed, [frames[i].image for i in apart.argmin(axis=1)]


def draw(followed: Followed, images: list[np.ndarray], step: int, ends: tuple[np.ndarray, np.ndarray]) -> Image.Image:
    """One frame of the picture: what the camera sees, and the storeys from the side."""
    figure = Figure(figsize=(_WIDTH, _HEIGHT), dpi=_DPI, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    seen = figure.add_axes((0.02, 0.1, 0.46, 0.74))
    seen.imshow(images[step])
    seen.set_axis_off()
    side = figure.add_axes((0.56, 0.1, 0.43, 0.86))
    _storeys(side, followed.segment.truth.translation, ends)
    truth = followed.segment.truth.translation[step]
    for name in _SHOWN[:2]:
        at = followed.poses[name][step].translation
        side.scatter(at[0], at[1], s=60, marker=_MARKS[name], color=COLORS[name], linewidths=0, zorder=3)
    modes: tuple[Mode, ...] = followed.beliefs["filter"].modes[step]
    for mode in modes:
        at = mode.world_from_camera.translation
        side.scatter(at[0], at[1], s=20 + 180 * mode.weight, color=COLORS["filter"], alpha=0.75, lw=0, zorder=2)
        label = f"{100 * mode.weight:.0f} %"
        side.annotate(label, (at[0], at[1]), (10, 5), textcoords="offset points", fontsize=9, color=COLORS["filter"])
    side.scatter(truth[0], truth[1], s=200, facecolors="none", edgecolors=INK, linewidths=1.5, zorder=4)
    seconds = 1e-9 * float(followed.segment.times_ns[step] - followed.segment.times_ns[0])
    places = "one place" if len(modes) == 1 else f"{len(modes)} places possible"
    figure.text(0.02, 0.9, f"{seconds:.1f} s", fontsize=13, color=INK)
    figure.text(0.13, 0.9, f"{places}, {followed.beliefs['filter'].status[step]}", fontsize=13, color=COLORS["filter"])
    figure.text(0.02, 0.03, "what the camera sees (real images, copied to three storeys)", fontsize=8, color=INK)
    marks = (("X", "single_image"), ("■", "kalman"), ("●", "filter"))
    for x, (mark, name) in zip((0.48, 0.605, 0.735), marks, strict=True):
        figure.text(x, 0.03, f"{mark} {_NAMES[name]}", fontsize=8, color=COLORS[name])
    figure.text(0.855, 0.03, "○ where it is", fontsize=8, color=INK)
    with io.BytesIO() as buffer:
        canvas.print_png(buffer)
        return Image.open(buffer).convert("RGB")


def _storeys(side: Axes, path: np.ndarray, ends: tuple[np.ndarray, np.ndarray]) -> None:
    """The walk on each storey, the middle one of which is walked in."""
    low, high = ends
    for storey in range(-1, _STOREYS - 1):
        side.plot(path[:, 0], path[:, 1] + 3.0 * storey, color=FAINT, linewidth=1.2, zorder=1)
    side.set_xlim(low[0], high[0] + 0.1 * (high[0] - low[0]))  # room for what stands beside a place
    side.set_ylim(low[1], high[1])
    heights = path[:, 1].mean() + 3.0 * np.arange(-1, _STOREYS - 1)
    side.set_yticks(heights, ["storey 1", "storey 2", "storey 3"], fontsize=9, color=INK)
    side.set_xticks([])
    side.tick_params(length=0)
    for name in ("top", "right", "bottom", "left"):
        side.spines[name].set_visible(False)


def main() -> None:
    """Draw it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("benchmark", type=Path, help="output of vapor-benchmark real")
    parser.add_argument("output", type=Path)
    parser.add_argument("--seed", type=int, default=0, help="which walk")
    words = parser.parse_args()
    followed, images = localized(RowContext(words.data, words.benchmark), words.seed)
    path = followed.segment.truth.translation
    margin = np.array([0.5, 4.3])
    low, high = path.min(axis=0)[:2] - margin, path.max(axis=0)[:2] + margin
    frames = [draw(followed, images, step, (low, high)) for step in range(len(images))]
    frames += [frames[-1]] * _HOLD
    first, *rest = frames
    first.save(words.output, save_all=True, append_images=rest, duration=_FRAME_MS, loop=0, quality=_QUALITY, method=6)
    print(f"{words.output}: {len(frames)} frames, {words.output.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
