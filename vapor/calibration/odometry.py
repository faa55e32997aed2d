"""The noise of a scene's odometry, from recordings with true poses."""

from __future__ import annotations

from collections.abc import Mapping

from sequences.errors import SequenceError
from sequences.odometry_fit.fit import fit_odometry
from sequences.odometry_fit.pieces import LEAST_INCREMENTS
from sequences.odometry_fit.result import OdometryFit
from vapor.training_data.ground import odometry_segments
from vapor.training_data.training_set import TrainingSet


def fit_first_odometry(data: Mapping[str, TrainingSet | None]) -> tuple[OdometryFit | None, str]:
    """How wrong odometry is on the first data that have enough of it, and the name of these.

    Args:
        data: Images by the name of the data that they are from; None where there are no such data.

    Returns:
        The fit and the name of the data; None and "none" where none of them has enough.
    """
    for name, images in data.items():
        segments = odometry_segments(images) if images is not None else []
        if sum(len(segment.odometry) for segment in segments) < LEAST_INCREMENTS:
            continue
        try:
            return fit_odometry(segments), name
        except SequenceError:  # the increments take no time
            continue
    return None, "none"
