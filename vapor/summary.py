"""What many trials add up to, per scene, kind of run and variant of the filter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from vapor.evaluate import FILES, REGIONS, THRESHOLDS

WITHIN_IMAGES = 50
"""A kidnapped filter should be right again after no more images than this."""

OFTEN = 0.05
"""Share of a run's images from which on being sure of a wrong place is more than a moment's."""

Results = Sequence[Mapping[str, Any]]


def summarise(results: Results) -> dict[str, dict[str, dict[str, Any]]]:
    """Aggregates of all results, by scene, kind and variant."""
    groups: dict[tuple[str, str, str], list[Mapping[str, Any]]] = {}
    for result in sorted(results, key=lambda each: each["name"]):
        groups.setdefault((result["scene"], result["kind"], result["variant"]), []).append(result)
    summary: dict[str, dict[str, dict[str, Any]]] = {}
    for (scene, kind, variant), group in groups.items():
        summary.setdefault(scene, {}).setdefault(kind, {})[variant] = _aggregate(group)
    return summary


def failed(result: Mapping[str, Any]) -> bool:
    """Whether a run is one to look at.

    With something unique on its way: it did not find itself. Without, or standing: it was sure of a wrong place in at
    least 5 % of its images. Carried off: it did not recover within 50 images.
    """
    if result["kind"] == "cue" or result["kind"].startswith("rate-"):
        return not result["methods"]["filter"]["success"]
    belief = result["belief"]["filter"]
    if result["kind"] in ("no-cue", "standing"):
        return _wrong_share(belief) >= OFTEN
    return not _recovered(belief)


def _aggregate(results: Results) -> dict[str, Any]:
    return {
        "runs": len(results),
        "images": sum(result["images"] for result in results),
        "methods": {name: _method([result["methods"][name] for result in results]) for name in FILES},
        "belief": {
            name: _belief([result["belief"][name] for result in results], [result["images"] for result in results])
            for name in ("kalman", "gaussian_sum", "filter")
        },
        "image_truth_among_modes": _mean([result["image_truth_among_modes"] for result in results]),
        "particles": float(np.median([result["particles"] for result in results])),
        "step_ms": float(np.median([result["step_ms"] for result in results])),
        "failed": [result["name"] for result in results if failed(result)],
    }


def _method(metrics: Results) -> dict[str, Any]:
    """Recalls are over all images of all runs, which are equally long; errors and times are medians over runs."""
    total: dict[str, Any] = {
        "median_translation_m": float(np.median([each["median_translation_m"] for each in metrics])),
        "median_rotation_deg": float(np.median([each["median_rotation_deg"] for each in metrics])),
        "recall": {name: _mean([each["recall"][name] for each in metrics]) for name in THRESHOLDS},
    }
    if "success" in metrics[0]:
        after = [each["after_convergence"] for each in metrics if each["success"]]
        images = [each["images"] for each in after]
        total["successes"] = len(after)
        total["converged_at_s"] = _median([each["converged_at_s"] for each in metrics if each["success"]])
        total["recall_after_convergence"] = {
            name: _mean([each["recall"][name] for each in after], images) for name in THRESHOLDS
        }
    return total


def _belief(beliefs: Results, images: Sequence[int]) -> dict[str, Any]:
    false_recoveries = [belief["false_recoveries"] for belief in beliefs]
    wrong = [_wrong_share(belief) for belief in beliefs]
    total: dict[str, Any] = {
        "status": {
            name: _mean([belief["status"][name] for belief in beliefs], images) for name in beliefs[0]["status"]
        },
        "said_converged": _consistency([belief["said_converged"] for belief in beliefs]),
        "after_convergence": _consistency([belief["after_convergence"] for belief in beliefs]),
        "truth_among_modes": _mean([belief["truth_among_modes"] for belief in beliefs], images),
        "false_recoveries": sum(false_recoveries),
        "runs_with_false_recovery": sum(number > 0 for number in false_recoveries),
        "runs_wrongly_converged": sum(share > 0 for share in wrong),
        "runs_wrongly_converged_often": sum(share >= OFTEN for share in wrong),
    }
    kidnaps = [belief["kidnap"] for belief in beliefs if belief["kidnap"] is not None]
    if kidnaps:
        needed = [kidnap["images"] for kidnap in kidnaps if kidnap["images"] is not None]
        total["kidnap"] = {
            "right_before": sum(kidnap["right_before"] for kidnap in kidnaps),
            "recovered_in_time": sum(_recovered(belief) for belief in beliefs),
            "recovered": len(needed),
            "median_images": _median(needed),
        }
    return total


def _consistency(parts: Results) -> dict[str, Any]:
    """Shares are over all images; the NEES is the median of the runs' medians."""
    said = [part for part in parts if part["images"]]
    images = [part["images"] for part in said]
    return {
        "images": sum(images),
        "wrong": _mean([part["wrong"] for part in said], images),
        "coverage": {region: _mean([part["coverage"][region] for part in said], images) for region in REGIONS},
        "median_nees": _median([part["median_nees"] for part in said]),
    }


def _wrong_share(belief: Mapping[str, Any]) -> float:
    """Share of all images of a run that say `converged` and are wrong."""
    return belief["status"]["converged"] * (belief["said_converged"]["wrong"] or 0.0)


def _recovered(belief: Mapping[str, Any]) -> bool:
    images = belief["kidnap"]["images"]
    return images is not None and images <= WITHIN_IMAGES


def _mean(values: Sequence[int | float], weights: Sequence[int | float] | None = None) -> float | None:
    return float(np.average(values, weights=weights)) if len(values) else None


def _median(values: Sequence[int | float]) -> float | None:
    return float(np.median(values)) if len(values) else None
