"""What live localization says of one image."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from filtering.estimate import Estimate
from filtering.se3 import Poses
from sequences.frame import Frame


@dataclass(frozen=True)
class LiveEstimate:
    """The belief after one image, and what a robot needs of it.

    Attributes:
        frame: The image, its stamp, and the odometry since the image before.
        estimate: What the filter believes.
        map_from_base: Pose of the odometry's child frame at the time of the image, by the best mode, one pose.
        map_from_odom: The transform from the map to the odometry's frame, one pose; None where the estimate is not
            converged, as it is not published then, either.
        latency_ms: Milliseconds from when the image was there until this was.
        skipped: How many images were left out so far, by reason.
    """

    frame: Frame
    estimate: Estimate
    map_from_base: Poses
    map_from_odom: Poses | None
    latency_ms: float
    skipped: Mapping[str, int]

    @property
    def time_ns(self) -> int:
        """Stamp of the image, integer nanoseconds."""
        return self.frame.time_ns
