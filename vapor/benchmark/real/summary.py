"""What the draws of each row of `vapor-benchmark real` add up to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from vapor.benchmark.evaluation.sequential import SUCCESS_M
from vapor.benchmark.methods import LOCALIZING
from vapor.evaluation.consistency import REGIONS
from vapor.evaluation.trajectory import POSITION_M, RIGHT


def summarise(results: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """What the draws of each row add up to, by its name and the images that are evaluated.

    Returns:
        For each, `group`, `draws`, `images`, `unit_m`; `methods`: for each of `LOCALIZING` the `median_translation_m`,
        `median_rotation_deg`, `right` (fraction within 0.3 m, times the unit, and 20°) and `worse_than_0.25m`
        (fraction, the limit times the unit), `position_recall` (likewise); `sequences`: by their length their number
        and, by method, their `success` (likewise); `whole_draws`:
        the fraction of the draws in which every image is `right`, by method, in which the filter says `converged` of
        every image, and in which it says so of none; `filter`: `converged` (fraction of the images that are said to be)
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
    everywhere, converged = ([belief[key] for belief in beliefs] for key in ("all_images", "said_converged"))

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
