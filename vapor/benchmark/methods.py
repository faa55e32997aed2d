"""The tracking methods as the benchmarks report them: which, in which order, and what tables call them."""

from __future__ import annotations

from vapor.tracking import methods

METHODS = tuple(methods.METHODS)
"""All of them, in the order of a report."""

LOCALIZING = tuple(method for method in METHODS if method != "dead_reckoning")
"""Those that find the camera by themselves: dead reckoning is told where it starts."""

BELIEVING = (*methods.BASELINES, "filter")
"""Those that say how confident they are, after every image."""

OURS = "filter"
"""The one that the benchmarks are about."""


def ours_first() -> list[str]:
    """Those that say how confident they are, the particle filter first."""
    return [OURS, *(method for method in BELIEVING if method != OURS)]


def label(method: str) -> str:
    """What a table calls a method."""
    return method.replace("_", " ")


def short_label(method: str) -> str:
    """What a narrow column calls a method."""
    return methods.METHODS[method].short_label or label(method)
