"""How well a method does with a fault: how soon it notices, whether it is right again, whether it was ever fooled.

And sums over all walks and faults.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Int64

from filtering.se3 import Poses
from vapor.benchmark.faults import table
from vapor.benchmark.faults.table import FAULTS, LONG_S, NONE, image_after
from vapor.evaluation.trajectory import convergence_s, is_right
from vapor.tracking.loop import Belief


def evaluate_fault(
    belief: Belief, times_ns: Int64[np.ndarray, " n"], truth: Poses, begin: int, during: range
) -> dict[str, Any]:
    """How well a method did with a fault.

    Args:
        times_ns: Stamps (n,), more or less evenly spaced.
        begin: Image at which the fault begins.
        during: Images that are affected.

    Returns:
        Fractions of the images from `begin` on: `right`, `converged`, `lost`, `sure_and_wrong` ("converged" and not
        right). Fractions of other images: `right_after`, of those from `SETTLED_S` after a fault of `FAULT_S` on;
        `noticed`, "lost" from `NOTICED_S` after the beginning to the end of the fault, None if there are none;
        `lost_ever`, of the whole walk. Also `success`, as in a trial, and over the whole walk `longest_s`, how long at
        most it was "converged" and not right without a break, and `longest_at_s`, when that began (None: never).
    """
    right = is_right(belief.best, truth)
    is_status = {name: np.array([status == name for status in belief.status]) for name in ("converged", "lost")}
    wrong = is_status["converged"] & ~right
    settled = image_after(table.FAULT_S + table.SETTLED_S, begin, times_ns)
    noticed = is_status["lost"][image_after(table.NOTICED_S, max(begin, during.start), times_ns) : during.stop]
    first, longest = longest_run(wrong)
    elapsed_s = (times_ns - times_ns[0]) / 1e9
    return {
        "success": convergence_s(times_ns, right) is not None,
        "right": float(right[begin:].mean()),
        "right_after": float(right[settled:].mean()),
        "converged": float(is_status["converged"][begin:].mean()),
        "lost": float(is_status["lost"][begin:].mean()),
        "noticed": float(noticed.mean()) if len(noticed) else None,
        "lost_ever": float(is_status["lost"].mean()),
        "sure_and_wrong": float(wrong[begin:].mean()),
        "longest_s": longest * float(np.median(np.diff(elapsed_s))),
        "longest_at_s": float(elapsed_s[first]) if longest else None,
    }


def longest_run(flags: Bool[np.ndarray, " n"]) -> tuple[int, int]:
    """First image and length of the longest run of true values, the first of several; length 0 if there is none."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(int)))
    first, length = edges[::2], edges[1::2] - edges[::2]
    if not len(first):
        return 0, 0
    longest = int(np.argmax(length))
    return int(first[longest]), int(length[longest])


def summarise_faults(results: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """Sums over all walks, by scene and fault, the run without a fault first.

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
