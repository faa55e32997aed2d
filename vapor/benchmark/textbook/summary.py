"""What the runs of a benchmark against textbook filters add up to, per scene and kind of trial."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from vapor.benchmark.localization.summary import WITHIN_IMAGES
from vapor.benchmark.textbook.methods import OURS
from vapor.benchmark.trials.kinds import KINDS
from vapor.evaluation.intervals import Walks

Results = Sequence[Mapping[str, Any]]


def summarise_methods(results: Results) -> dict[str, dict[str, dict[str, Any]]]:
    """Aggregates of all results, by scene, kind and key of the method."""
    groups: dict[tuple[str, str, str], list[Mapping[str, Any]]] = {}
    for result in sorted(results, key=lambda each: each["name"]):
        for key in result["methods"]:
            groups.setdefault((result["scene"], result["kind"], key), []).append(result)
    summary: dict[str, dict[str, dict[str, Any]]] = {}
    for (scene, kind, key), group in groups.items():
        summary.setdefault(scene, {}).setdefault(kind, {})[key] = _aggregate(group, key)
    return summary


def _aggregate(results: Results, key: str) -> dict[str, Any]:
    """Times are over all images of all runs; how they compare with ours' is a median over runs, each side by side."""
    walks = Walks([result["walk"] for result in results])
    figures = [result["methods"][key] for result in results]
    median_ms, p95_ms = np.percentile(np.concatenate([each["step_ms"] for each in figures]), [50, 95])
    ratios = [
        float(np.median(each["step_ms"]) / np.median(result["methods"][OURS]["step_ms"]))
        for each, result in zip(figures, results, strict=True)
    ]
    errors_m = [each["trajectory"]["median_translation_m"] for each in figures]
    successes = [_succeeded(result["kind"], each) for result, each in zip(results, figures, strict=True)]
    said, wrong = float(sum(each["converged"] for each in figures)), sum(each["sure_and_wrong"] for each in figures)
    return {
        "runs": len(results),
        "walks": walks.count,
        "particles": float(np.median([each["particles"] for each in figures])),
        "median_ms": float(median_ms),
        "p95_ms": float(p95_ms),
        "over_ours": float(np.median(ratios)),
        "successes": None if None in successes else sum(map(bool, successes)),
        "median_translation_m": float(np.median(errors_m)),
        "converged": said / len(results),
        "converged_and_wrong": wrong / said if said > 0.0 else None,
        "intervals": {
            "over_ours": walks.median(ratios),
            "successes": None if None in successes else walks.number([bool(success) for success in successes]),
            "median_translation_m": walks.median(errors_m),
            "converged_and_wrong": walks.mean(
                [each["sure_and_wrong"] / each["converged"] if each["converged"] else None for each in figures],
                [each["converged"] for each in figures],
            ),
        },
    }


def _succeeded(kind: str, figures: Mapping[str, Any]) -> bool | None:
    """Whether it found itself, or recovered in time; None where nothing shows where the camera is."""
    like = KINDS[kind].like
    if like == "kidnap":
        return figures["recovery_images"] is not None and figures["recovery_images"] <= WITHIN_IMAGES
    return figures["trajectory"]["success"] if like == "cue" else None
