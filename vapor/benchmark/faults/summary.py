"""What all walks with all faults add up to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from vapor.benchmark.faults.table import FAULTS, NONE
from vapor.benchmark.faults.timing import LONG_S


def summarise_faults(results: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """What all walks add up to, by scene and fault, the run without a fault first.

    Returns:
        For each, the number of `walks`, and for each of `methods`: `successes`; the fractions of `evaluate_fault`,
        averaged over the walks; `longest_s`, of any walk; `unsuccessful`, names of walks; and `sure_and_wrong_walks`,
        the names of those that were so for longer than `LONG_S`, with when that began and how long it lasted, seconds.
    """
    groups: dict[str, dict[str, list[Mapping[str, Any]]]] = {}
    order = (NONE, *FAULTS)
    for result in sorted(results, key=lambda each: (each["scene"], order.index(each["fault"]), each["name"])):
        groups.setdefault(result["scene"], {}).setdefault(result["fault"], []).append(result)
    return {
        scene: {
            fault: {
                "walks": len(group),
                "methods": {name: _aggregate(group, name) for name in group[0]["methods"]},
            }
            for fault, group in faults.items()
        }
        for scene, faults in groups.items()
    }


def _aggregate(results: Sequence[Mapping[str, Any]], method: str) -> dict[str, Any]:
    parts = [(result["name"], result["methods"][method]) for result in results]
    fractions = ("right", "right_after", "converged", "lost", "noticed", "lost_ever", "sure_and_wrong")
    known = {name: [part[name] for _, part in parts if part[name] is not None] for name in fractions}
    return {
        "successes": sum(part["success"] for _, part in parts),
        **{name: float(np.mean(values)) if values else None for name, values in known.items()},
        "longest_s": max(part["longest_s"] for _, part in parts),
        "unsuccessful": [name for name, part in parts if not part["success"]],
        "sure_and_wrong_walks": {
            name: [part["longest_at_s"], part["longest_s"]] for name, part in parts if part["longest_s"] > LONG_S
        },
    }
