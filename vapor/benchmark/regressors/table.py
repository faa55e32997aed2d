"""Results of training runs in tables: every method on every scene, as in the paper's two tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from rich.table import Table

from vapor.benchmark.figures import Number, new_table, percent, spread, values_at
from vapor.evaluation.trajectory import RIGHT, THRESHOLDS


def scene_tables(results: Sequence[Mapping[str, Any]], gamma: float) -> dict[str, Table]:
    """The table of every scene: medians over the seeds, and for recall of several its least and most."""
    return {scene: _scene_table(scene, rows, gamma) for scene, rows in _by_scene(results).items()}


def best_methods(results: Sequence[Mapping[str, Any]]) -> list[str]:
    """For each scene a sentence on the method with the highest median recall at the widest threshold."""
    sentences = []
    for scene, rows in _by_scene(results).items():
        recalls = {method: spread(values_at(own, "recall", RIGHT)).value or 0.0 for method, own in rows.items()}
        best = max(recalls, key=lambda method: recalls[method])
        sentences.append(f"{scene}: {best} has the highest recall within {RIGHT}, {percent(recalls[best])}.")
    return sentences


def failures(results: Sequence[Mapping[str, Any]]) -> list[str]:
    """A line for each network that could not be trained."""
    return [f"{r['scene']}, {r['label']}, seed {r['seed']}: {r['error']}" for r in results if "error" in r]


Rows = Mapping[str, Sequence[Mapping[str, Any]]]
"""Results by method."""


def _by_scene(results: Sequence[Mapping[str, Any]]) -> dict[str, Rows]:
    scenes: dict[str, dict[str, list[Mapping[str, Any]]]] = {}
    for result in results:
        if "error" not in result:
            scenes.setdefault(result["scene"], {}).setdefault(result["label"], []).append(result)
    return dict(scenes)


def _scene_table(scene: str, rows: Rows, gamma: float) -> Table:
    every = [row for own in rows.values() for row in own]
    seeds = len({row["seed"] for row in every})
    counted = "1 seed" if seeds == 1 else f"{seeds} seeds"
    filtered = any("filter" in row for row in every)
    columns = ["method", *(f"recall {t}" for t in THRESHOLDS), f"best mode {RIGHT}", f"any sample {RIGHT}"]
    columns += ["median error of the mean", "of the best mode", "−log p̂", "modes"]
    if filtered:
        columns += ["filter: success", "median error", "converged, of these wrong", "smoothed: success"]
    table = new_table(f"{scene}, {every[0]['images']} test images, {counted}, γ = {gamma:g}", *columns, "training")
    for column in table.columns:
        column.no_wrap = False
    for method, own in rows.items():
        cells = [method, *(_spread(values_at(own, "recall", t)) for t in THRESHOLDS)]
        cells += [percent(spread(values_at(own, kind, RIGHT)).value) for kind in ("mode_recall", "oracle_recall")]
        cells += [_error(values_at(own, kind)) for kind in ("mean", "mode")]
        exact = spread(values_at(own, "exact_negative_log_density")).value
        of_samples = f"{_median(own, 'negative_log_density'):.2f}"
        cells.append(of_samples if exact is None else f"{of_samples} (exact {exact:.2f})")
        cells.append(f"{_median(own, 'modes'):.1f}")
        if filtered:
            cells += _filtered([report for row in own for report in row["filter"]])
        table.add_row(*cells, f"{_median(own, 'seconds') / 60:.1f} min")
    return table


def _filtered(reports: Sequence[Mapping[str, Any]]) -> list[str]:
    """Of reports of runs: how many succeed, errors, and how far `converged` can be trusted."""
    runs = values_at(reports, "filter")
    converged = values_at(reports, "consistency", "images")
    wrong = [fraction or 0.0 for fraction in values_at(reports, "consistency", "wrong")]  # None where never converged
    images = sum(values_at(reports, "frames_with_true_pose"))
    of_converged = float(np.dot(converged, wrong)) / sum(converged) if sum(converged) else None
    return [
        f"{sum(map(bool, values_at(runs, 'success')))} of {len(runs)}",
        _error([{k: run[f"median_{k}"] for k in ("translation_m", "rotation_deg")} for run in runs]),
        f"{percent(sum(converged) / images)}, {percent(of_converged)}",
        f"{sum(map(bool, values_at(reports, 'smoothed', 'success')))} of {len(runs)}",
    ]


def _median(results: Sequence[Mapping[str, Any]], key: str) -> float:
    return float(np.median(values_at(results, key)))


def _spread(values: Sequence[Number]) -> str:
    among = f" ({100 * min(values):.0f}-{100 * max(values):.0f})" if len(values) > 1 else ""
    return f"{percent(float(np.median(values)))}{among}"


def _error(errors: Sequence[Mapping[str, Any]]) -> str:
    return f"{_median(errors, 'translation_m'):.2f} m, {_median(errors, 'rotation_deg'):.1f}°"
