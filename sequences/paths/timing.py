"""When the images and the odometry of a synthetic sequence are taken."""

from __future__ import annotations

import numpy as np
from jaxtyping import Int64

from filtering.se3 import Poses
from sequences.paths.motion import STEP_S

IMAGE_RATE_HZ = 10.0
"""Paths are chosen by what is seen at this rate, and made to last so long; that of all scenes but buildings."""
IMAGE_PERIOD_NS, ODOMETRY_PERIOD_NS = 100_000_000, 20_000_000
EPOCH_NS = 1_700_000_000_000_000_000  # the first odometry message
_LEAD_NS = 513_000_000  # the first image comes later, and between two odometry messages
TAIL_S = 0.5  # of odometry after the last image at 10 Hz
EXPOSURE_S = 0.014  # of an image, around its stamp


def image_stamps(count: int, rate_hz: float = IMAGE_RATE_HZ) -> Int64[np.ndarray, " n"]:
    """Stamps of so many images."""
    since_first = np.round(np.arange(count) * 1e9 / rate_hz).astype(np.int64)
    return EPOCH_NS + _LEAD_NS + since_first


def odometry_stamps(base: Poses) -> Int64[np.ndarray, " k"]:
    """Stamps of the odometry along a path."""
    return EPOCH_NS + round(STEP_S * 1e9) * np.arange(len(base), dtype=np.int64)


def poses_at(times_ns: np.ndarray, poses: Poses, query_ns: np.ndarray) -> Poses:
    """Poses at other times, along the geodesic between neighbours."""
    after = np.clip(np.searchsorted(times_ns, query_ns, side="right"), 1, len(times_ns) - 1)
    fraction = (query_ns - times_ns[after - 1]) / (times_ns[after] - times_ns[after - 1])
    return poses[after - 1].interpolate(poses[after], fraction)
