"""Recordings made by others: each row is prepared once, and evaluated again when the filter has changed."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool

from filtering.config import LocalizerConfig
from filtering.errors import VaporTrackError, require_within
from vapor.benchmark.evaluation import LOCALIZING, SUCCESS_M, compare, evaluate_sequences
from vapor.benchmark.real.row import Draw, RowContext
from vapor.benchmark.real.rows import ROWS, Row
from vapor.cache import cached, code_digest
from vapor.engines.engine import EngineConfig
from vapor.evaluation.consistency import REGIONS
from vapor.evaluation.trajectory import POSITION_M, RIGHT
from vapor.parallel.jobs import Workers, in_parallel
from vapor.threads import limited_threads
from vapor.tracking.follow import Followed, follow


def summarise(results: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """Sums over the draws of each row, by its name and the images that are evaluated.

    Returns:
        For each, `group`, `draws`, `images`, `unit_m`; `methods`: for each of `LOCALIZING` the `median_translation_m`,
        `median_rotation_deg`, `right` (fraction within 0.3 m, times the unit, and 20°) and `worse_than_0.25m`
        (fraction, the limit times the unit), `position_recall` (likewise); `sequences`: by their length their number
        and, by method, their `success` (likewise); `whole_draws`:
        the fraction of the draws in which every image is `right`, by method, in which the filter is `converged` in
        every image, and in none; `filter`: `converged` (fraction of the images)
        and `wrong` of these, `coverage` of all images and `coverage_converged` (each by region), `median_nees` of all.
        Every figure is the median of the draws, the lowest and the highest; None if no draw has one.
    """
    rows: dict[str, list[Mapping[str, Any]]] = {}
    for result in results:
        rows.setdefault(", ".join(filter(None, (result["row"], result["of"]))), []).append(result)
    return {name: _summary(draws) for name, draws in rows.items()}


Figure = list[float] | None
"""Of several draws the median, the lowest and the highest; None if none has one."""


def _summary(draws: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    first = draws[0]
    unit_m = first["unit_m"]
    beliefs = [draw["belief"]["filter"] for draw in draws]
    everywhere, converged = ([belief[key] for belief in beliefs] for key in ("all_images", "converged_images"))

    def of(method: str) -> dict[str, Any]:
        each = [draw["methods"][method] for draw in draws]
        return {
            "median_translation_m": _figure([one["median_translation_m"] * unit_m for one in each]),
            "median_rotation_deg": _figure([one["median_rotation_deg"] for one in each]),
            "right": _figure([one["recall"][RIGHT] for one in each]),
            "worse_than_0.25m": _figure([one["worse_than"]["0.25m"] for one in each]),
            "position_recall": {name: _figure([one["position_recall"][name] for one in each]) for name in POSITION_M},
        }

    def in_sequences(length: str) -> dict[str, Any]:
        each = [draw["sequences"][length] for draw in draws]
        known = [one["success"] for one in each if one["success"] is not None]
        return {
            "sequences": each[0]["sequences"],
            "success": {
                method: {limit: _figure([one[method][limit] for one in known]) for limit in SUCCESS_M}
                for method in (known[0] if known else ())
            },
        }

    def coverage(parts: Sequence[Mapping[str, Any]]) -> dict[str, Figure]:
        known = [part["coverage"] for part in parts if part["coverage"] is not None]
        return {region: _figure([each[region] for each in known]) for region in REGIONS}

    return {
        "group": first["group"],
        "draws": len(draws),
        "images": first["images"],
        "unit_m": unit_m,
        "methods": {method: of(method) for method in LOCALIZING},
        "sequences": {length: in_sequences(length) for length in first["sequences"]},
        "whole_draws": {
            "right": {
                method: float(np.mean([draw["methods"][method]["recall"][RIGHT] == 1.0 for draw in draws]))
                for method in LOCALIZING
            },
            "converged": float(np.mean([belief["status"]["converged"] == 1.0 for belief in beliefs])),
            "never_converged": float(np.mean([belief["status"]["converged"] == 0.0 for belief in beliefs])),
        },
        "filter": {
            "converged": _figure([belief["status"]["converged"] for belief in beliefs]),
            "wrong": _figure([part["wrong"] for part in converged if part["wrong"] is not None]),
            "coverage": coverage(everywhere),
            "coverage_converged": coverage(converged),
            "median_nees": _figure([part["median_nees"] for part in everywhere]),
        },
    }


def _figure(values: Sequence[float]) -> Figure:
    return [float(np.median(values)), min(values), max(values)] if values else None


_CODE = (
    "sequences.estimates",
    "sequences.odometry",
    "sequences.odometry_fit",
    "vapor.benchmark.evaluation",
    "vapor.benchmark.real.row",
    "vapor.benchmark.real.rows",
    "vapor.benchmark.real.trained_network",
    "vapor.benchmark.recordings",
    "vapor.calibration",
    "vapor.checkpoints",
    "vapor.evaluation",
    "vapor.pipeline.fuse",
    "vapor.tracking",
)


@dataclass(frozen=True)
class RealConfig(EngineConfig):
    """Settings of a benchmark on real recordings."""

    seeds: int = 3
    """Draws of simulated odometry; recorded odometry has one."""
    num_samples: int = 1000
    """Posterior samples per image."""
    localizer: LocalizerConfig = field(default_factory=LocalizerConfig)
    """The particle filter."""

    def __post_init__(self) -> None:
        require_within(self, seeds=(1, 10**6), num_samples=(1, 10**6))


def choose(data: Path, only: Sequence[str]) -> tuple[list[Row], dict[str, list[str]]]:
    """The rows asked for whose data are all there, and the missing data of the others, by their names.

    Args:
        data: Folder with the recordings.
        only: Names of rows or of their groups; empty for all.

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


def measure(rows: Sequence[Row], context: RowContext, config: RealConfig) -> Iterator[list[dict[str, Any]]]:
    """The results of every row and draw, in order; cached ones of the same settings and code are not computed again.

    Yields:
        For each set of images of a draw that is evaluated: `row`, `group`, `of` (which images), `seed`, `unit_m`, what
        `Comparison.figures` gives, lengths in units of `unit_m` metres, and `sequences`, see `evaluate_sequences`.

    Raises:
        VaporTrackError: unusable data, or an output that cannot be written to.
    """
    for row in rows:
        for seed in range(config.seeds if row.simulated else 1):
            with limited_threads(1):
                yield _evaluated(row, seed, context, config)


def measure_rows(
    rows: Sequence[Row], data: Path, output: Path, config: RealConfig, workers: Workers
) -> Iterator[list[dict[str, Any]]]:
    """The results of every row as it is done, in no order: all that `measure` gives of it, in one list.

    Raises:
        VaporTrackError: as `measure`, and as `in_parallel`.
    """
    yield from in_parallel(_measured, [(row.name, data, output, config) for row in rows], workers)


def _measured(name: str, data: Path, output: Path, config: RealConfig) -> list[dict[str, Any]]:
    """As `measure` of one row, by its name: rows hold functions, which do not travel."""
    (row,) = (row for row in ROWS if row.name == name)
    return [result for draw in measure([row], RowContext(data, output, config.num_samples), config) for result in draw]


def _evaluated(row: Row, seed: int, context: RowContext, config: RealConfig) -> list[dict[str, Any]]:
    prepared = row.prepare(context, seed)
    settings = {"prepared": prepared, "localizer": asdict(config.localizer), "code": results_code(row)}
    settings = json.loads(json.dumps(settings))

    def compute() -> list[dict[str, Any]]:
        context.advance("localizing", seed, None)
        draw = row.draw(context, seed, config.localizer)
        followed = follow(draw.segment, draw.errors, draw.localizer, rng=np.random.default_rng(seed))
        compared = compare(followed).scaled(1.0 / draw.unit_m)
        return [
            {"row": row.name, "group": row.group, "of": what, "seed": seed, "unit_m": draw.unit_m}
            | compared.figures(images)
            | {"sequences": _in_sequences(draw, followed, seed, images)}
            for what, images in draw.evaluated.items()
        ]

    return cached(context.folder("results") / f"{row.name}-{seed}", settings, compute)


def _in_sequences(draw: Draw, followed: Followed, seed: int, images: Bool[np.ndarray, " n"]) -> dict[str, Any]:
    if not draw.in_sequences:
        return {}
    return evaluate_sequences(followed, seed=(seed,), images=images, unit_m=draw.unit_m)


def results_code(row: Row) -> str:
    """Digest of the code that the results of a row depend on."""
    return code_digest(*_CODE, type(row).__module__)
