"""Stamps of frames that have none, and odometry between frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from filtering.motion import MotionNoise, Odometry
from filtering.se3 import Poses
from sequences.estimates.pose_files import FrameName, PoseFile, natural_order
from sequences.frame import BASE_FROM_CAMERA
from sequences.reading.counts import uncovered
from sequences.trajectories.interpolation import MAX_ODOMETRY_GAP_S, interpolate, odometry_between


@dataclass(frozen=True)
class OdometryTrack:
    """Odometry of the body in one sequence: stamps (k,), poses (k,), twist covariances (k, 6, 6); zeros: unknown."""

    times_ns: Int64[np.ndarray, " k"]
    odom_from_base: Poses
    twist_covariances: Float64[np.ndarray, "k 6 6"]

    def why_uncovered(self, time_ns: int) -> str:
        """The reason to count where odometry does not cover a time."""
        return uncovered(time_ns, self.times_ns)

    def covers(self, time_ns: int) -> bool:
        """Whether odometry tells where the body was."""
        asked = np.array([time_ns], np.int64)
        return bool(interpolate(self.times_ns, self.odom_from_base, asked, max_gap_s=MAX_ODOMETRY_GAP_S)[1][0])

    def between(self, start_ns: int, end_ns: int, motion_noise: MotionNoise) -> Odometry:
        """Motion of the camera between two covered times; the noise is that of odometry that states none."""
        return odometry_between(
            self.times_ns,
            self.odom_from_base,
            self.twist_covariances,
            start_ns,
            end_ns,
            base_from_camera=BASE_FROM_CAMERA,
            motion_noise=motion_noise,
        )


def frame_stamps(files: Sequence[PoseFile], rate_hz: float) -> dict[FrameName, int]:
    """Nanoseconds of every frame: its own stamp, or made up from its number, a second between sequences."""
    frames = sorted({frame for file in files for frame in file.frames}, key=natural_order)
    if files[0].timed:
        return {frame: frame.number for frame in frames}
    stamps: dict[FrameName, int] = {}
    begin_ns, first, last = 0, 0, None
    for frame in frames:
        if last is None or frame.sequence != last.sequence:
            begin_ns, first = 0 if last is None else stamps[last] + 1_000_000_000, frame.number
        stamps[frame] = begin_ns + round((frame.number - first) * 1_000_000_000 / rate_hz)
        last = frame
    return stamps
