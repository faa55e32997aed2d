"""A sequence whose frames have gravity, and whose odometry turns as a gyroscope does: an inertial unit beside it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from filtering.se3 import Poses
from filtering.storeys import up_axis
from sequences.frame import Frame, Gravity
from sequences.frame_source import ChangedSequence, FrameSource
from sequences.inertial.barometer import Ride
from sequences.inertial.motion_sensors import MotionSensors, Up
from sequences.inertial.samples import InertialSamples

_FEWEST, _VARIES_DEG = 10, 10.0  # frames with gravity and a true pose; median angle


class InertialSequence(ChangedSequence):
    """The frames of another sequence with gravity, and with odometry that a gyroscope and a barometer correct."""

    def __init__(
        self,
        frames: FrameSource,
        samples: InertialSamples | None,
        notices: Sequence[str] = (),
        *,
        rides: Sequence[Ride] = (),
        usual_up: Up | None = None,
    ) -> None:
        """Around a sequence.

        Args:
            frames: The sequence.
            samples: Of the unit, about the axes of the camera; None for none.
            notices: Of reading them.
            rides: In lifts, by a barometer.
            usual_up: Up about the axes of the camera where no gravity is known, as of a robot; None where it varies.
        """
        super().__init__(frames)
        self._samples, self._rides, self._usual_up, self._said = samples, rides, usual_up, notices
        self._sensors = MotionSensors()
        self._with_truth: list[tuple[Poses, Gravity]] = []

    @property
    def notices(self) -> list[str]:
        """Those of the other sequence, and of the sensors."""
        of_sensors = [*self._said, *self._sensors.missing, *self._sensors.notices]
        return [*self._frames.notices, *of_sensors, *beside_true_poses(self._with_truth)]

    def __iter__(self) -> Iterator[Frame]:
        """Frames in order of time, see the sequence."""
        self._sensors, self._with_truth = MotionSensors(usual_up=self._usual_up), []
        self._sensors.extend(self._samples, self._rides)
        before_ns: int | None = None
        for frame in self._frames:
            seen = self._sensors.seen(frame, before_ns)
            before_ns = frame.time_ns
            if seen.gravity is not None and frame.world_from_reference is not None:
                self._with_truth.append((frame.world_from_reference, seen.gravity))
            yield seen


def beside_true_poses(found: Sequence[tuple[Poses, Gravity]]) -> list[str]:
    """What is wrong with gravity, by true poses world_from_camera at the same times: sentences for users."""
    if len(found) < _FEWEST:
        return []
    poses = Poses.stack([pose for pose, _ in found])
    ups = np.stack([pose.rotation @ np.asarray(gravity.up) for pose, gravity in found])
    middle = np.median(ups, axis=0)
    middle /= max(float(np.linalg.norm(middle)), 1e-12)
    off_deg = float(np.degrees(np.median(np.arccos(np.clip(ups @ middle, -1.0, 1.0)))))
    if off_deg > _VARIES_DEG:
        return [
            f"gravity varies by {off_deg:.0f}° (median) beside the true poses, expected {_VARIES_DEG:.0f}° at most:"
            " the unit's mount in tf, its axes or its clock are others"
        ]
    if middle @ up_axis(poses) < np.cos(np.radians(135.0)):
        return ["gravity is upside down beside the true poses: the unit states it downwards, or is mounted so"]
    return []
