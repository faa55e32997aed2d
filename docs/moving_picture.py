"""Draws the moving picture of the README from what `make demo` wrote: what the camera sees, and what is believed.

python docs/moving_picture.py demo/staircase docs/staircase.webp
"""

from __future__ import annotations

import csv
import io
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from sequences.reader import SequenceReader
from sequences.recordings.bag import Bag
from sequences.recordings.messages import pose_from_message, stamp_ns
from vapor.reporting.drawing import COLORS, FAINT, INK

_EVERY = 2  # images, ten a second
_UNTIL_S = 20.0
_HOLD = 12  # frames at the end
_WIDTH, _HEIGHT, _DPI = 8.4, 3.9, 100
_QUALITY = 60


@dataclass(frozen=True)
class Moment:
    """One image, and what was believed of it: particles (n, 3), places of modes (k, 3) and their weights (k,)."""

    seconds: float
    image: np.ndarray
    particles: np.ndarray
    modes: np.ndarray
    weights: np.ndarray
    truth: np.ndarray
    status: str


def moments(folder: Path) -> list[Moment]:
    """Of a demo's folder, in order of time."""
    with (folder / "status.csv").open() as file:
        statuses = [row["status"] for row in csv.DictReader(file)]
    particles, modes = {}, {}
    for raw in Bag(folder / "estimate.mcap").messages(["/estimate/particles", "/estimate/modes"]):
        message = raw.decode()
        if raw.topic.endswith("particles"):
            poses = [pose_from_message(pose).translation for pose in message.poses]
            particles[stamp_ns(message.header)] = np.stack(poses)
        else:
            arrows = message.markers[1:]
            places = [[a.points[0].x, a.points[0].y, a.points[0].z] for a in arrows]
            modes[stamp_ns(arrows[0].header)] = np.array(places), np.array([a.color.a for a in arrows])
    told: list[Moment] = []
    start_ns = 0
    for frame, status in zip(SequenceReader(folder / "sequence.mcap"), statuses, strict=True):
        start_ns = start_ns or frame.time_ns
        assert frame.world_from_camera is not None
        places, weights = modes[frame.time_ns]
        seconds, truth = (frame.time_ns - start_ns) / 1e9, frame.world_from_camera.translation
        told.append(Moment(seconds, frame.image, particles[frame.time_ns], places, weights, truth, status))
    return told


def draw(moment: Moment, path: np.ndarray, low: np.ndarray, high: np.ndarray) -> Image.Image:
    """One frame of the picture, seen from the side."""
    figure = Figure(figsize=(_WIDTH, _HEIGHT), dpi=_DPI, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    seen = figure.add_axes((0.02, 0.06, 0.5, 0.78))
    seen.imshow(moment.image)
    seen.set_axis_off()
    side = figure.add_axes((0.62, 0.08, 0.36, 0.88))
    side.plot(path[:, 0], path[:, 2], color=FAINT, linewidth=1.2, zorder=1)
    side.scatter(moment.particles[:, 0], moment.particles[:, 2], s=16, color=COLORS["filter"], alpha=0.25, lw=0)
    side.scatter(*moment.truth[[0, 2]], s=110, facecolors="none", edgecolors=INK, linewidths=1.6, zorder=4)
    for place, weight in zip(moment.modes, moment.weights, strict=True):
        side.annotate(f"{100 * weight:.0f} %", place[[0, 2]], (8, 6), textcoords="offset points", fontsize=9, color=INK)
    side.set_xlim(low[0], high[0] + 0.25 * (high[0] - low[0]))  # room for what stands beside a place
    side.set_ylim(low[2], high[2])
    side.set_ylabel("height [m]", color=INK, fontsize=9)
    side.set_xticks([])
    side.tick_params(labelsize=8, colors=INK)
    for name in ("top", "right", "bottom"):
        side.spines[name].set_visible(False)
    count = len(moment.weights)
    possible = "one place" if count == 1 else f"{count} places possible"
    figure.text(0.09, 0.9, f"{moment.seconds:.1f} s", fontsize=13, color=INK, ha="right")
    badge = {"facecolor": COLORS[moment.status], "edgecolor": "none", "boxstyle": "round,pad=0.35"}
    figure.text(0.115, 0.9, moment.status, fontsize=13, color=INK, bbox=badge)
    figure.text(0.265, 0.9, possible, fontsize=13, color=INK)
    figure.text(0.02, 0.015, "what the camera sees (synthetic)", fontsize=8, color=INK)
    figure.text(0.62, 0.015, "blue: particles   ring: where it is   line: its path", fontsize=8, color=INK)
    with io.BytesIO() as buffer:
        canvas.print_png(buffer)
        return Image.open(buffer).convert("RGB")


def main(folder: Path, output: Path) -> None:
    """Draw it."""
    told = moments(folder)
    path = np.stack([moment.truth for moment in told])
    everything = np.concatenate([path, *(moment.particles for moment in told)])
    low, high = np.percentile(everything, [0.2, 99.8], axis=0)
    pad = 0.06 * (high - low)
    shown = [moment for moment in told[::_EVERY] if moment.seconds <= _UNTIL_S]
    frames = [draw(moment, path, low - pad, high + pad) for moment in shown]
    frames += [frames[-1]] * _HOLD
    first, *rest = frames
    first.save(output, save_all=True, append_images=rest, duration=100, loop=0, quality=_QUALITY, method=6)
    print(f"{output}: {len(frames)} frames, {output.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
