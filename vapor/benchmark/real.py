"""Every figure on recordings made by others: each row prepared once, judged again where the filter has changed."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from filtering.config import LocalizerConfig
from filtering.errors import VaporTrackError, require_within
from vapor.benchmark.real_rows import ROWS, Place, Row
from vapor.cache import cached, code_digest
from vapor.evaluation.comparison import compare
from vapor.evaluation.consistency import REGIONS
from vapor.evaluation.trajectory import RIGHT
from vapor.threads import limited_threads
from vapor.tracking import methods
from vapor.tracking.follow import follow

METHODS = tuple(name for name in methods.METHODS if name != "dead_reckoning")
"""Of a table, in its order: dead reckoning is told where it starts."""

_CODE = (
    "sequences.estimates",
    "sequences.odometry",
    "sequences.odometry_fit",
    "vapor.benchmark.real_rows",
    "vapor.benchmark.recordings",
    "vapor.calibration",
    "vapor.checkpoints",
    "vapor.evaluation",
    "vapor.pipeline.estimate_model",
    "vapor.pipeline.fuse",
    "vapor.tracking",
)


@dataclass(frozen=True)
class RealConfig:
    """Settings of a benchmark on real recordings."""

    seeds: int = 3
    """Draws of simulated odometry; what is recorded with odometry has one."""
    num_samples: int = 1000
    """Posterior samples per image."""
    localizer: LocalizerConfig = field(default_factory=LocalizerConfig)
    """The particle filter."""

    def __post_init__(self) -> None:
        require_within(self, seeds=(1, 10**6), num_samples=(1, 10**6))


def choose(data: Path, only: Sequence[str]) -> tuple[list[Row], dict[str, list[str]]]:
    """The rows asked for of which all is there, and what is missing of the others, by their names.

    Args:
        data: Folder with the recordings.
        only: Names of rows or of their groups; all where there is none.

    Raises:
        VaporTrackError: no such folder, an unknown name, or nothing is left.
    """
    if not data.is_dir():
        raise VaporTrackError(f"{data}: no such folder, expected one with recordings such as {ROWS[0].needs[0]}")
    known = dict.fromkeys([*(row.group for row in ROWS), *(row.name for row in ROWS)])
    for name in only:
        if name not in known:
            raise VaporTrackError(f"unknown row {name!r}, expected one of {', '.join(known)}")
    asked = [row for row in ROWS if not only or row.name in only or row.group in only]
    missing = {row.name: [need for need in row.needs if not (data / need).exists()] for row in asked}
    rows = [row for row in asked if not missing[row.name]]
    if not rows:
        lacking = dict.fromkeys(need for needs in missing.values() for need in needs)
        raise VaporTrackError(f"{data}: nothing to measure, expected any of {', '.join(lacking)} in it")
    return rows, {name: needs for name, needs in missing.items() if needs}


def measure(rows: Sequence[Row], place: Place, config: RealConfig) -> Iterator[list[dict[str, Any]]]:
    """The results of every row and draw, in order; what is there of the same settings and code is not computed again.

    Yields:
        For each group of images that a draw is judged by: `row`, `group`, `of` (which images), `seed`, `unit_m`, and
        what `Comparison.figures` gives, lengths in units of `unit_m` metres.

    Raises:
        VaporTrackError: unusable data, or an output that cannot be written to.
    """
    for row in rows:
        for seed in range(config.seeds if row.simulated else 1):
            with limited_threads(1):
                yield _judged(row, seed, place, config)


def _judged(row: Row, seed: int, place: Place, config: RealConfig) -> list[dict[str, Any]]:
    prepared = row.prepare(place, seed)
    settings = {"prepared": prepared, "localizer": asdict(config.localizer), "code": _code()}
    settings = json.loads(json.dumps(settings))

    def compute() -> list[dict[str, Any]]:
        place.advance("localizing", seed, None)
        draw = row.draw(place, seed, config.localizer)
        followed = follow(draw.passage, draw.errors, draw.localizer, rng=np.random.default_rng(seed))
        compared = compare(followed).scaled(1.0 / draw.unit_m)
        return [
            {"row": row.name, "group": row.group, "of": what, "seed": seed, "unit_m": draw.unit_m}
            | compared.figures(images)
            for what, images in draw.judged.items()
        ]

    return cached(place.folder("results") / f"{row.name}-{seed}", settings, compute)


def summarise(results: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """What the draws of each row add up to, by its name and the images it is judged by.

    Returns:
        For each `group`, `draws`, `images`, `unit_m`; `methods`: for each of `METHODS` the `median_translation_m`,
        `median_rotation_deg`, `right` (share within 0.3 m and 20°, times the unit) and `worse_than_0.25m` (share, times
        the unit); `filter`: `converged` (share of the images that are said to be) and `wrong` of these, `coverage` of
        all images and `coverage_converged` (each by the region), `median_nees` of all. Every figure is the median of
        the draws, the lowest and the highest of them; None where no draw has one.
    """
    rows: dict[str, list[Mapping[str, Any]]] = {}
    for result in results:
        rows.setdefault(", ".join(filter(None, (result["row"], result["of"]))), []).append(result)
    return {name: _summary(draws) for name, draws in rows.items()}


Figure = list[float] | None
"""Of several draws the median, the lowest and the highest; None where none has one."""


def _summary(draws: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    first = draws[0]
    unit_m = first["unit_m"]
    beliefs = [draw["belief"]["filter"] for draw in draws]
    everywhere, sure = ([belief[key] for belief in beliefs] for key in ("all_images", "said_converged"))

    def of(method: str) -> dict[str, Figure]:
        each = [draw["methods"][method] for draw in draws]
        return {
            "median_translation_m": _figure([one["median_translation_m"] * unit_m for one in each]),
            "median_rotation_deg": _figure([one["median_rotation_deg"] for one in each]),
            "right": _figure([one["recall"][RIGHT] for one in each]),
            "worse_than_0.25m": _figure([one["worse_than"]["0.25m"] for one in each]),
        }

    def coverage(parts: Sequence[Mapping[str, Any]]) -> dict[str, Figure]:
        told = [part["coverage"] for part in parts if part["coverage"] is not None]
        return {region: _figure([each[region] for each in told]) for region in REGIONS}

    return {
        "group": first["group"],
        "draws": len(draws),
        "images": first["images"],
        "unit_m": unit_m,
        "methods": {method: of(method) for method in METHODS},
        "filter": {
            "converged": _figure([belief["status"]["converged"] for belief in beliefs]),
            "wrong": _figure([part["wrong"] for part in sure if part["wrong"] is not None]),
            "coverage": coverage(everywhere),
            "coverage_converged": coverage(sure),
            "median_nees": _figure([part["median_nees"] for part in everywhere]),
        },
    }


def _figure(values: Sequence[float]) -> Figure:
    return [float(np.median(values)), min(values), max(values)] if values else None


def _code() -> str:
    """Digest of the code that results depend on."""
    return code_digest(*_CODE)
