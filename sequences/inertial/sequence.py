"""A sequence whose frames have gravity, and whose odometry turns as a gyroscope does: an inertial unit beside it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from filtering.motion import Odometry
from filtering.se3 import Poses
from filtering.storeys import up_axis
from sequences.frame import Frame, Gravity
from sequences.frame_source import FrameSource
from sequences.inertial.barometer import LiftRides, Ride
from sequences.inertial.gravity import gravity_along
from sequences.inertial.gyroscope import GyroscopeFusion
from sequences.inertial.samples import InertialSamples
from sequences.reading.counts import ImageCounts

_LEAST_S = 0.01  # a motion of less time says nothing of how a gyroscope turns
_FEWEST, _VARIES_DEG = 10, 10.0  # frames with gravity and a true pose; median angle


class InertialSequence:
    """The frames of another sequence with gravity, and with odometry that a gyroscope and a barometer correct.

    All else is as of the other sequence.

    Attributes:
        corrects_odometry: Whether there is a gyroscope, or a ride in a lift.
    """

    def __init__(
        self,
        frames: FrameSource,
        samples: InertialSamples | None,
        notices: list[str],
        restated: Callable[[Odometry], Odometry] | None = None,
        *,
        rides: Sequence[Ride] = (),
        usual_up: tuple[float, float, float] | None = None,
    ) -> None:
        """Around a sequence.

        Args:
            frames: The sequence.
            samples: Of the unit, about the axes of the camera; None for none.
            notices: Of reading them.
            restated: Gives the odometry of the frames with its fitted noise, where it is corrected.
            rides: In lifts, by a barometer.
            usual_up: Up about the axes of the camera where no gravity is known, as of a robot; None where it varies.
        """
        self._rides, self._usual_up, self._lifts = list(rides), usual_up, LiftRides([])
        self._samples = samples
        measures_turns = samples is not None and bool(np.isfinite(samples.turn_rate).any())
        self.corrects_odometry = measures_turns or len(self._rides) > 0
        self._restated, self._gyroscope = restated, None if samples is None else GyroscopeFusion(samples)
        self._frames, self._notices = frames, notices
        self._gravity = None if samples is None else gravity_along(samples)
        self.path, self.camera, self.num_images = frames.path, frames.camera, frames.num_images
        self.has_odometry = frames.has_odometry
        self.image_description = frames.image_description
        self.odometry_description = frames.odometry_description
        self._num_frames = self._num_without = 0
        self._with_truth: list[tuple[Poses, Gravity]] = []

    @property
    def counts(self) -> ImageCounts:
        """Counts of the images of the latest iteration; complete after it."""
        return self._frames.counts

    @property
    def skipped(self) -> Counter[str]:
        """How many images of the latest iteration were left out, by reason."""
        return self._frames.skipped

    @property
    def resolved(self) -> dict[str, Any]:
        """The options that would read the same."""
        return self._frames.resolved

    @property
    def notices(self) -> list[str]:
        """Sentences for users; complete after an iteration."""
        missing = []
        if self._num_without:
            missing = [f"{self._num_without} of {self._num_frames} images have no gravity: gaps of the inertial unit"]
        turns = [*self._lifts.notices, *([] if self._gyroscope is None else self._gyroscope.notices)]
        return [*self._frames.notices, *self._notices, *missing, *turns, *beside_true_poses(self._with_truth)]

    def __iter__(self) -> Iterator[Frame]:
        """Frames in order of time, see the sequence."""
        self._num_frames = self._num_without = 0
        self._with_truth = []
        self._gyroscope = None if self._samples is None else GyroscopeFusion(self._samples)
        self._lifts = LiftRides(self._rides)
        before_ns: int | None = None
        for frame in self._frames:
            gravity = None if self._gravity is None else self._gravity.at(frame.time_ns)
            self._num_frames += 1
            self._num_without += self._gravity is not None and gravity is None
            if gravity is not None and frame.world_from_reference is not None:
                self._with_truth.append((frame.world_from_reference, gravity))
            odometry = self._corrected(before_ns, frame, self._usual_up if gravity is None else gravity.up)
            before_ns = frame.time_ns
            yield replace(frame, gravity=gravity, odometry=odometry)

    def _corrected(self, before_ns: int | None, frame: Frame, up: tuple[float, float, float] | None) -> Odometry | None:
        """The odometry of a frame with its rotation corrected by the gyroscope, and with the heights of rides."""
        odometry = frame.odometry
        if odometry is None or before_ns is None or not self.corrects_odometry:
            return odometry
        if self._restated is not None:
            odometry = self._restated(odometry)
        odometry = self._lifts.step(before_ns, frame.time_ns, odometry, up)
        if self._gyroscope is None or odometry is None or odometry.duration_s < _LEAST_S:
            return odometry  # such a short one is between images of several cameras
        return self._gyroscope.step(before_ns, frame.time_ns, odometry)


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
