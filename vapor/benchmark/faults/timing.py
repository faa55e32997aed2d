"""When a fault begins, how long it lasts, and what comes after: seconds, and the images in them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Int64

from filtering.estimate import Status

CONVERGED_S = 5.0
"""The filter has been converged for this long when a fault begins."""

FAULT_S = 5.0
"""How long a fault lasts."""

SETTLED_S = 5.0
"""This long after its end all should be as if it had not been."""

REMAINING_S = 10.0
"""At least this much of the walk is left after its end."""

NOTICED_S = 3.0
"""A fault that can be noticed should be noticed this long after its beginning."""

LONG_S = 1.0
"""To be confident of a wrong place for longer than this is a failure."""

BEHIND_S = 0.2
"""How late the stamps of late odometry are."""

AHEAD_S = 1.0
"""How far a clock jumps."""


def find_moment(status: Sequence[Status], times_ns: Int64[np.ndarray, " n"]) -> int | None:
    """The first image before which the filter was converged for `CONVERGED_S`, with time left for a fault and beyond.

    Args:
        status: Of the filter without a fault, (n,).
        times_ns: Stamps (n,), more or less evenly spaced.

    Returns:
        Its number, or None.
    """
    converged = np.array([each == "converged" for each in status])
    if len(converged) < 2:
        return None
    step_ns = float(np.median(np.diff(times_ns)))
    for image in range(image_after(CONVERGED_S, 0, times_ns), len(converged)):
        since = image_after(-CONVERGED_S, image, times_ns)
        left_ns = times_ns[-1] - times_ns[image] + step_ns
        if left_ns >= (FAULT_S + REMAINING_S) * 1e9 - step_ns / 2 and converged[since:image].all():
            return image
    return None


def images_in(duration_s: float, times_ns: Int64[np.ndarray, " n"]) -> int:
    """How many images there are in so many seconds of more or less evenly spaced stamps (n,), n ≥ 2."""
    return round(duration_s * 1e9 / float(np.median(np.diff(times_ns))))


def image_after(duration_s: float, image: int, times_ns: Int64[np.ndarray, " n"]) -> int:
    """The first of n ≥ 2 images at least so many seconds after one of them, by stamps that may jitter; n if none is."""
    jitter_ns = float(np.median(np.diff(times_ns))) / 2.0
    return int(np.searchsorted(times_ns, times_ns[image] + duration_s * 1e9 - jitter_ns))
