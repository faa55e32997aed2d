"""Sums over the trials of `vapor-benchmark localization`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from vapor.benchmark.evaluation import BELIEVING, SUCCESS_M
from vapor.benchmark.figures import Walks, values_at
from vapor.benchmark.trials.choose import KINDS
from vapor.evaluation.consistency import REGIONS
from vapor.tracking.methods import METHODS

WITHIN_IMAGES = 50
"""A kidnapped filter should be right again after at most this many images."""

OFTEN = 0.05
"""Fraction of a run's images from which on being confident of a wrong place is more than momentary."""

Results = Sequence[Mapping[str, Any]]


def summarise(results: Results) -> dict[str, dict[str, dict[str, Any]]]:
    """Sums over all results, by scene, kind and ablation; figures are `Figure`s with their intervals over walks."""
    groups: dict[tuple[str, str, str], list[Mapping[str, Any]]] = {}
    for result in sorted(results, key=lambda each: each["name"]):
        groups.setdefault((result["scene"], result["kind"], result["variant"]), []).append(result)
    summary: dict[str, dict[str, dict[str, Any]]] = {}
    for (scene, kind, ablation), group in groups.items():
        summary.setdefault(scene, {}).setdefault(kind, {})[ablation] = _aggregate(group)
    return summary


def failed(result: Mapping[str, Any]) -> bool:
    """Whether a run is one to look at.

    With something unique on its way: it did not find the right place. Without, or standing: it was confident of a wrong
    place in at least 5 % of its images. Carried off: it did not recover within 50 images.
    """
    like, belief = KINDS[result["kind"]].like, result["belief"]["filter"]
    if like == "cue":
        return not result["methods"]["filter"]["success"]
    return _wrong_fraction(belief) >= OFTEN if like == "no-cue" else not _recovered(belief)


def _aggregate(results: Results) -> dict[str, Any]:
    walks = Walks([result["walk"] for result in results])
    images = values_at(results, "images")
    total = {
        "runs": len(results),
        "walks": walks.count,
        "images": sum(images),
        "methods": {name: _method([result["methods"][name] for result in results], walks) for name in METHODS},
        "belief": {name: _belief([result["belief"][name] for result in results], images, walks) for name in BELIEVING},
        "image_truth_among_modes": walks.mean(values_at(results, "image_truth_among_modes")),
        "particles": float(np.median(values_at(results, "particles"))),
        "step_ms": float(np.median(values_at(results, "step_ms"))),
        "failed": [result["name"] for result in results if failed(result)],
    }
    if "sequences" in results[0]:
        total["sequences"] = {
            length: _sequences([result["sequences"][length] for result in results], walks)
            for length in results[0]["sequences"]
        }
    return total


def _method(metrics: Results, walks: Walks) -> dict[str, Any]:
    """Recalls are over all images of all runs, which have the same length; errors and times are medians over runs."""
    total: dict[str, Any] = {
        "median_translation_m": walks.median(values_at(metrics, "median_translation_m")),
        "median_rotation_deg": walks.median(values_at(metrics, "median_rotation_deg")),
    }
    for name in ("recall", "position_recall"):
        total[name] = {limit: walks.mean(values_at(metrics, name, limit)) for limit in metrics[0][name]}
    if "success" in metrics[0]:
        images = [number or 0 for number in values_at(metrics, "after_convergence", "images")]
        total["successes"] = walks.number(values_at(metrics, "success"))
        total["converged_at_s"] = walks.median(values_at(metrics, "converged_at_s"))
        total["recall_after_convergence"] = {
            limit: walks.mean(values_at(metrics, "after_convergence", "recall", limit), images)
            for limit in metrics[0]["recall"]
        }
    if "storey_accuracy" in metrics[0]:
        total["storey_accuracy"] = walks.mean(values_at(metrics, "storey_accuracy"))
    if "storey" in metrics[0]:
        settled = values_at(metrics, "storey", "settled_images")
        total["storey"] = {
            "but_for_it": walks.mean(values_at(metrics, "storey", "but_for_it")),
            "settled_images": sum(settled),
            "settled_right": walks.mean(values_at(metrics, "storey", "settled_right"), settled),
        }
    return total


def _sequences(parts: Results, walks: Walks) -> dict[str, Any]:
    numbers = values_at(parts, "sequences")
    names = dict.fromkeys(name for part in parts for name in part["success"] or ())
    return {
        "sequences": sum(numbers),
        "success": {
            name: {limit: walks.mean(values_at(parts, "success", name, limit), numbers) for limit in SUCCESS_M}
            for name in names
        },
    }


def _belief(beliefs: Results, images: Sequence[int], walks: Walks) -> dict[str, Any]:
    false_recoveries = values_at(beliefs, "false_recoveries")
    wrong = [_wrong_fraction(belief) for belief in beliefs]
    right = [belief["status"]["converged"] - fraction for belief, fraction in zip(beliefs, wrong, strict=True)]
    total: dict[str, Any] = {
        "status": {name: walks.mean(values_at(beliefs, "status", name), images) for name in beliefs[0]["status"]},
        "rightly_converged": walks.mean(right, images),
        "truth_among_modes": walks.mean(values_at(beliefs, "truth_among_modes"), images),
        "reliability": _reliability(values_at(beliefs, "reliability"), walks),
        "false_recoveries": sum(false_recoveries),
        "runs_with_false_recovery": sum(number > 0 for number in false_recoveries),
        "runs_wrongly_converged": walks.number([fraction > 0 for fraction in wrong]),
        "runs_wrongly_converged_often": sum(fraction >= OFTEN for fraction in wrong),
        "longest_wrong_s": max(values_at(beliefs, "longest_wrong_s")),
    }
    for name in ("converged_images", "after_convergence", "on_storey"):
        if name in beliefs[0]:
            total[name] = _consistency([belief[name] for belief in beliefs], walks)
    if beliefs[0]["kidnap"] is not None:
        needed = values_at(beliefs, "kidnap", "images")
        total["kidnap"] = {
            "right_before": sum(values_at(beliefs, "kidnap", "right_before")),
            "recovered_in_time": walks.number([_recovered(belief) for belief in beliefs]),
            "recovered": sum(number is not None for number in needed),
            "median_images": walks.median(needed),
        }
    return total


def _consistency(parts: Results, walks: Walks) -> dict[str, Any]:
    """Fractions are over all images; the NEES is the median of the runs' medians."""
    images = values_at(parts, "images")
    return {
        "images": sum(images),
        "wrong": walks.mean(values_at(parts, "wrong"), images),
        "coverage": {region: walks.mean(values_at(parts, "coverage", region), images) for region in REGIONS},
        "median_nees": walks.median(values_at(parts, "median_nees")),
    }


def _reliability(parts: Results, walks: Walks) -> dict[str, Any]:
    """By ranges of the best mode's weight, over all images."""
    found = {}
    for low in sorted({low for part in parts for low in part}):
        of_range = [part.get(low, {"images": 0, "stated": None, "right": None}) for part in parts]
        images = values_at(of_range, "images")
        found[low] = {
            "images": sum(images),
            **{name: walks.mean(values_at(of_range, name), images) for name in ("stated", "right")},
        }
    return found


def _wrong_fraction(belief: Mapping[str, Any]) -> float:
    """Fraction of all images of a run that are `converged` and wrong."""
    return belief["status"]["converged"] * (belief["converged_images"]["wrong"] or 0.0)


def _recovered(belief: Mapping[str, Any]) -> bool:
    images = belief["kidnap"]["images"]
    return images is not None and images <= WITHIN_IMAGES
