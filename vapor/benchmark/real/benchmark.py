"""Recordings made by others: each row is prepared once, and evaluated again when the filter has changed."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from filtering.errors import VaporTrackError
from vapor.benchmark.evaluation import LOCALIZING, SUCCESS_M, all_poses, evaluate_methods, evaluate_sequences
from vapor.benchmark.figures import spread, values_at
from vapor.benchmark.real.row import Row, RowContext
from vapor.benchmark.real.rows import ROWS
from vapor.cache import cached, code_digest
from vapor.evaluation.consistency import REGIONS
from vapor.evaluation.trajectory import POSITION_M, RIGHT
from vapor.threads import limited_threads
from vapor.tracking.follow import follow

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


def measure(row: Row, context: RowContext) -> list[dict[str, Any]]:
    """The results of all draws of a row; cached ones of the same settings and code are not computed again.

    Returns:
        For each set of images of a draw that is evaluated: `row`, `group`, `of` (which images), `seed`, `unit_m`, what
        `evaluate_methods` gives, lengths in units of `unit_m` metres, and `sequences`, see `evaluate_sequences`.

    Raises:
        VaporTrackError: unusable data.
    """
    with limited_threads(1):
        seeds = range(context.config.seeds if row.simulated else 1)
        return [result for seed in seeds for result in _of_draw(row, seed, context)]


def _of_draw(row: Row, seed: int, context: RowContext) -> list[dict[str, Any]]:
    prepared = row.prepare(context, seed)
    settings = {"prepared": prepared, "localizer": asdict(context.config.localizer), "code": results_code(row)}

    def compute() -> list[dict[str, Any]]:
        draw = row.draw(context, seed)
        followed = follow(draw.segment, draw.noise, draw.localizer, rng=np.random.default_rng(seed))
        poses = all_poses(followed)
        results = []
        for what, images in draw.evaluated.items():
            figures = evaluate_methods(followed, poses, images, unit_m=draw.unit_m)
            figures["sequences"] = {}
            if draw.in_sequences:
                figures["sequences"] = evaluate_sequences(followed, seed=(seed,), images=images, unit_m=draw.unit_m)
            names = {"row": row.name, "group": row.group, "of": what, "seed": seed, "unit_m": draw.unit_m}
            results.append(names | figures)
        return results

    return cached(context.folder("results") / f"{row.name}-{seed}", json.loads(json.dumps(settings)), compute)


def results_code(row: Row) -> str:
    """Digest of the code that the results of a row depend on."""
    return code_digest(*_CODE, type(row).__module__)


def summarise(results: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """Sums over the draws of each row, by its name and the images that are evaluated.

    Returns:
        For each, `group`, `draws`, `images`, `unit_m`; `methods`: for each of `LOCALIZING` the `median_translation_m`,
        `median_rotation_deg`, `right` (fraction within 0.3 m, times the unit, and 20°) and `worse_than_0.25m`
        (fraction, the limit times the unit), `position_recall` (by limit, times the unit); `sequences`: by their length
        their number and, by method, their `success`; `whole_draws`: the fraction of the draws in which every image is
        `right`, by method, in which the filter is `converged` in every image, and in none; `filter` and `smoothed`:
        `converged` (fraction of the images) and `wrong` of these, `coverage` of all images and `coverage_converged`
        (each by region), `median_nees` of all. Every figure is the median of the draws, the lowest and the highest.
    """
    rows: dict[str, list[Mapping[str, Any]]] = {}
    for result in results:
        rows.setdefault(", ".join(filter(None, (result["row"], result["of"]))), []).append(result)
    return {name: _summary(draws) for name, draws in rows.items()}


def _summary(draws: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    first = draws[0]
    sure = values_at(draws, "belief", "filter", "status", "converged")
    recalls = {method: values_at(draws, "methods", method, "recall", RIGHT) for method in LOCALIZING}
    return {
        "group": first["group"],
        "draws": len(draws),
        "images": first["images"],
        "unit_m": first["unit_m"],
        "methods": {method: _method(values_at(draws, "methods", method), first["unit_m"]) for method in LOCALIZING},
        "sequences": {length: _sequences(values_at(draws, "sequences", length)) for length in first["sequences"]},
        "whole_draws": {
            "right": {method: float(np.mean(np.equal(values, 1.0))) for method, values in recalls.items()},
            "converged": float(np.mean(np.equal(sure, 1.0))),
            "never_converged": float(np.mean(np.equal(sure, 0.0))),
        },
        **{name: _confidence(values_at(draws, "belief", name)) for name in ("filter", "smoothed")},
    }


def _confidence(beliefs: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    everywhere, converged = (values_at(beliefs, key) for key in ("all_images", "converged_images"))
    return {
        "converged": spread(values_at(beliefs, "status", "converged")),
        "wrong": spread(values_at(converged, "wrong")),
        "coverage": {region: spread(values_at(everywhere, "coverage", region)) for region in REGIONS},
        "coverage_converged": {region: spread(values_at(converged, "coverage", region)) for region in REGIONS},
        "median_nees": spread(values_at(everywhere, "median_nees")),
    }


def _method(draws: Sequence[Mapping[str, Any]], unit_m: float) -> dict[str, Any]:
    return {
        "median_translation_m": spread([error * unit_m for error in values_at(draws, "median_translation_m")]),
        "median_rotation_deg": spread(values_at(draws, "median_rotation_deg")),
        "right": spread(values_at(draws, "recall", RIGHT)),
        "worse_than_0.25m": spread(values_at(draws, "worse_than", "0.25m")),
        "position_recall": {limit: spread(values_at(draws, "position_recall", limit)) for limit in POSITION_M},
    }


def _sequences(draws: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    methods = next((each["success"] for each in draws if each["success"] is not None), {})
    return {
        "sequences": draws[0]["sequences"],
        "success": {
            method: {limit: spread(values_at(draws, "success", method, limit)) for limit in SUCCESS_M}
            for method in methods
        },
    }
