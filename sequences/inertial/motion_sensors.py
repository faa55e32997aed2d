"""Gravity of frames, and odometry that a gyroscope and a barometer correct: of recordings and streams alike."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from filtering.motion import Odometry
from sequences.frame import Frame, Gravity
from sequences.inertial.barometer import LiftRides, Ride
from sequences.inertial.gravity import GravityFilter
from sequences.inertial.gyroscope import GyroscopeFusion
from sequences.inertial.samples import InertialSamples

Up = tuple[float, float, float]


class MotionSensors:
    """What an inertial unit and a barometer say of frames, as far as their samples have come.

    Attributes:
        usual_up: Up about the axes of the camera where no gravity is known, as of a robot; None where it varies.
        gyroscope: Its turns.
        lifts: Rides of a camera that stands still by its odometry.
        num_frames, num_without: Numbers of frames, and of those without gravity beside a unit.
    """

    def __init__(self, *, usual_up: Up | None = None) -> None:
        """Before the first sample."""
        self.usual_up, self._gravity = usual_up, GravityFilter()
        self.gyroscope, self.lifts = GyroscopeFusion(), LiftRides()
        self._has_unit = False
        self.num_frames = self.num_without = 0

    def extend(self, samples: InertialSamples | None, rides: Sequence[Ride] = ()) -> None:
        """Take samples of the unit that are later than those before, and rides that are known now."""
        if samples is not None:
            self._has_unit = True
            self._gravity.extend(samples)
            self.gyroscope.extend(samples)
        self.lifts.extend(rides)

    def begin_anew(self) -> None:
        """Forget the samples of the unit: their clock was set."""
        self._gravity = GravityFilter()
        self.gyroscope.begin_anew()

    def forget_before(self, time_ns: int) -> None:
        """Drop samples that only earlier frames need."""
        self._gravity.forget_before(time_ns)
        self.gyroscope.forget_before(time_ns)

    def seen(self, frame: Frame, begin_ns: int | None) -> Frame:
        """A frame with its gravity and its corrected odometry.

        Args:
            frame: The frame.
            begin_ns: When its motion began: stamp of the frame before it; None for the first.
        """
        gravity = self._gravity.at(frame.time_ns)
        self.num_frames += 1
        self.num_without += self._has_unit and gravity is None
        if begin_ns is None:
            return replace(frame, gravity=gravity)
        odometry = self.corrected(begin_ns, frame.time_ns, frame.odometry, gravity)
        return replace(frame, gravity=gravity, odometry=odometry)

    def corrected(
        self, begin_ns: int, end_ns: int, odometry: Odometry | None, gravity: Gravity | None
    ) -> Odometry | None:
        """The motion of the camera between two times; None where it is unknown.

        Args:
            begin_ns, end_ns: The times.
            odometry: By wheels or images; None where that is unknown.
            gravity: At the end.
        """
        up = self.usual_up if gravity is None else gravity.up
        return self.gyroscope.step(begin_ns, end_ns, self.lifts.step(begin_ns, end_ns, odometry, up))

    @property
    def notices(self) -> list[str]:
        """Sentences for users on the motions so far."""
        return [*self.lifts.notices, *self.gyroscope.notices]

    @property
    def missing(self) -> list[str]:
        """A sentence for users, where frames were without gravity."""
        if not self.num_without:
            return []
        return [f"{self.num_without} of {self.num_frames} images have no gravity: gaps of the inertial unit"]
