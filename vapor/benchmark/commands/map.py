"""`vapor-benchmark map`."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from jaxtyping import Float64
from rich.table import Table

from filtering.se3 import Poses
from filtering.so3 import nearest_rotation
from sequences.datasets.frames import posed_frames
from sequences.datasets.listing import files_read, is_recording, list_images
from sequences.mapping.config import MapConfig
from sequences.mapping.map import map_images
from sequences.options import SequenceOptions
from vapor.benchmark import PROGRAM
from vapor.benchmark.commands.options import SummaryPath, claim_summary, write_rows
from vapor.commands.console import OutputPath, Overwrite, command_line, parse, show, show_notices
from vapor.commands.progress import progress


@dataclass(frozen=True)
class Options:
    """Map the images of recordings and data sets, and compare their poses with the true ones."""

    data: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="DATA ...")]
    """Recordings and data sets with true poses, all in one frame. Of a recording only its odometry gives the scale."""
    output: OutputPath
    """Folder for the map, new or an earlier one."""
    overwrite: Overwrite = False
    summary: SummaryPath = None
    config: Annotated[MapConfig, tyro.conf.arg(name="")] = field(default_factory=MapConfig)


@dataclass(frozen=True)
class Errors:
    """How far poses are from the true ones after the similarity that fits all of them best.

    Attributes:
        scale: Of the similarity: metres for one unit of the map.
        metres, degrees: Errors of each image, (n,).
    """

    scale: float
    metres: Float64[np.ndarray, " n"]
    degrees: Float64[np.ndarray, " n"]

    @classmethod
    def of(cls, found: Poses, true: Poses) -> Errors:
        """Compare poses, batches (n,), after Umeyama's similarity (1991)."""
        a, b = (poses.translation - poses.translation.mean(axis=0) for poses in (found, true))
        rotation = nearest_rotation(b.T @ a)
        scale = float(np.sum(b * (a @ rotation.T)) / np.sum(a**2))
        aligned = Poses(rotation @ found.rotation, scale * a @ rotation.T + true.translation.mean(axis=0))
        metres, radians = aligned.distance(true)
        return cls(scale, metres, np.degrees(radians))


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    o, command = parse("map", Options, arguments, PROGRAM), command_line("map", arguments, PROGRAM)
    claim_summary(o.summary)
    begin_s = time.monotonic()
    with progress() as shown:
        result = map_images(
            o.data,
            o.output,
            o.config,
            reading=SequenceOptions(ground_truth_topic="") if all(map(is_recording, o.data)) else None,
            command=command,
            overwrite=o.overwrite,
            reads=chain.from_iterable(map(files_read, o.data)),
            progress=lambda stage, done, total: shown.at(
                stage, done, total, unit="pairs" if stage == "matching pairs" else "images"
            ),
        )
    seconds = time.monotonic() - begin_s
    found, known = list_images(o.output), dict(zip(result.walks, _true_poses(o.data), strict=True))
    names = [(file.parent.name, file.stem) for file in found.files if isinstance(file, Path)]
    true = Poses.stack([known[walk][int(stem.replace(".", ""))] for walk, stem in names])
    errors = Errors.of(found.world_from_camera, true)
    table = Table(title=f"{result.placed} of {result.images} images, {seconds:.0f} s", title_justify="left")
    for name in ("walk", "placed", "median error", "95 %", "largest", "rotation"):
        table.add_column(name, justify="left" if name == "walk" else "right")
    walks = np.array([walk for walk, _ in names])
    rows = []
    for name, (placed, images) in result.walks.items():
        if not placed:
            rows.append({"walk": name, "placed": 0, "images": images, "seconds": seconds})
            continue
        metres, degrees = errors.metres[walks == name], float(np.median(errors.degrees[walks == name]))
        figures = [float(value) for value in (np.median(metres), np.quantile(metres, 0.95), metres.max())]
        table.add_row(name, f"{placed} of {images}", *(f"{100 * each:.1f} cm" for each in figures), f"{degrees:.2f}°")
        of_walk = dict(zip(("median_m", "p95_m", "largest_m"), figures, strict=True))
        rows.append(
            {"walk": name, "placed": placed, "images": images, "seconds": seconds, "median_deg": degrees} | of_walk
        )
    show(table)
    write_rows(o.summary, rows)
    show(f"unit: {result.scale.source or 'arbitrary'}; {errors.scale:.4f} m")
    show_notices(result.notices)


def _true_poses(data: Sequence[Path]) -> list[Mapping[int, Poses]]:
    """Those of each walk, by what a map names its images by: stamps in nanoseconds, or numbers."""
    known: list[Mapping[int, Poses]] = []
    for path in data:
        stamped = is_recording(path) or list_images(path).assumed_hz is None
        walks: dict[int, dict[int, Poses]] = {}
        for frame in posed_frames(path, odometry="ignored"):
            assert frame.world_from_camera is not None
            walk = walks.setdefault(frame.sequence, {})
            walk[frame.time_ns if stamped else len(walk)] = frame.world_from_camera
        known += walks.values()
    return known
