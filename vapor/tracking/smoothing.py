"""The smoothed trajectory, computed from all images of a run at once."""

from __future__ import annotations

from filtering.config import LocalizerConfig
from filtering.error_model import ErrorModel
from filtering.se3 import Poses
from vapor.tracking.history import History


def smooth_history(history: History, errors: ErrorModel, config: LocalizerConfig) -> Poses:
    """Smooth a run.

    Args:
        history: A run of n images.
        errors: How its images err.
        config: Settings of the filter; only the slow errors of odometry are used.

    Returns:
        world_from_camera, batch (n,).
    """
    from filtering.smoothing import SMOOTHED_MODES, SmoothingConfig, smooth  # loads GTSAM, which takes a while

    return smooth(
        [modes[:SMOOTHED_MODES] for modes in history.evidence],
        history.odometry,
        history.normalized_distances,
        history.filtered,
        history.converged,
        errors,
        SmoothingConfig(slow_errors=config.slow_errors),
    )
