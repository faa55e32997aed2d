"""The inertial unit and the barometer of a running system: found, heard, and what they say of frames."""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from sequences.errors import SequenceError
from sequences.frame import Frame, Gravity
from sequences.inertial.barometer import Barometer
from sequences.inertial.motion_sensors import MotionSensors, Up
from sequences.inertial.samples import InertialUnit
from sequences.inertial.topics import IMU_TYPE, PRESSURE_TYPE, find_barometer, find_inertial, without_metres
from sequences.live.topic_buffer import TopicBuffer
from sequences.options import ReadingOptions
from sequences.reading.roles import Roles
from sequences.reading.timeline import ClockOfStream
from sequences.recordings.messages import stamp_ns
from sequences.recordings.source import TF_STATIC, RawMessage, decode

_KEPT_NS, _PRESSURE_NS = 30 * 10**9, 120 * 10**9  # samples of a unit, and pressures, that are remembered
_MOST_NEW = 500  # messages
_ENOUGH_FRAMES = 60  # to say how their motions differ
_SILENT_S, _LATE_S = 5.0, 0.1
_LOOKS = 3  # at topics that are there and say nothing yet, or are not linked by tf yet


class LiveSensors:
    """Samples in as they come, frames out with gravity and corrected odometry.

    Nothing waits for a sensor: a frame gets what its samples say so far. A sensor whose clock is set begins anew, and
    keeps the bias that was found. One that is not there at the beginning is looked for again.

    Attributes:
        motion: What the sensors say.
        unit: The inertial unit; None before it is found.
        barometer: Likewise.
    """

    def __init__(self, heard: TopicBuffer, options: ReadingOptions, roles: Roles) -> None:
        """Find the sensors among the topics, as `run` does.

        Raises:
            NotFoundError: one that is named is not there yet.
            SequenceError: it cannot be used.
        """
        self._heard, self._options = heard, options
        self._camera_frame, self._camera_is = roles.camera_frame, f" ({roles.image.name})"
        self.motion = MotionSensors()
        self.unit: InertialUnit | None = None
        self.barometer: Barometer | None = None
        self._clocks: dict[str, ClockOfStream] = {}
        self._came_s: dict[str, float] = {}
        self._said: dict[str, None] = {}
        self._looks_left, self._num_new = _LOOKS, 0
        self._have_spoken = set[str]()  # topics
        self._apart_s = 0.0  # stamp of the latest sample after that of the latest image
        self._look(is_first=True)

    def begin(self, *, usual_up: Up | None, has_metres: bool) -> None:
        """Before the first frame.

        Args:
            usual_up: See `MotionSensors`.
            has_metres: Whether odometry is in metres, to which heights can be added.
        """
        self.motion.usual_up = usual_up
        if not has_metres:
            if self.barometer is not None:
                self._said[without_metres(self.barometer.name)] = None
            self.barometer, self._options = None, replace(self._options, pressure_topic="")

    @staticmethod
    def hear(heard: TopicBuffer, options: ReadingOptions) -> None:
        """Subscribe what may be a sensor, so that the first messages are there when they are looked for."""
        for named, of_type in ((options.imu_topic, IMU_TYPE), (options.pressure_topic, PRESSURE_TYPE)):
            for topic in list(heard.topics.values()):
                if topic.read_as == of_type and named in (None, topic.name):
                    with suppress(SequenceError):  # of several types: no sensor
                        heard.hear(topic.name)

    def look_again(self, *, changed: bool) -> None:
        """Look for sensors that are not there yet, a few times after topics have `changed`, or one spoke at last."""
        self._looks_left = _LOOKS if changed else self._looks_left
        if self._looks_left > 0:
            self._looks_left -= 1
            self._look()

    def _look(self, *, is_first: bool = False) -> None:
        options, heard = self._options, self._heard
        self.hear(heard, options)
        if self.unit is None:
            self.unit, said = find_inertial(heard, options, self._camera_frame, self._camera_is)
            # A first message, or transform, may be about to come.
            self._said |= dict.fromkeys([] if self.unit is None and is_first else said)
        if self.barometer is None:
            self.barometer = find_barometer(heard, options)

    @property
    def names(self) -> list[str]:
        """Topics of the sensors that were found."""
        return [each.name for each in (self.unit, self.barometer) if each is not None]

    def take(self, raw: RawMessage) -> None:
        """Take a message of any topic; those of others are ignored."""
        if raw.topic not in self._have_spoken or raw.topic == TF_STATIC:  # it may be, or link, what was looked for
            self._have_spoken.add(raw.topic)
            self._looks_left = _LOOKS
        if raw.topic not in self.names:
            return
        message = decode(self._heard, raw, tolerate=True)
        time_ns = None if message is None else stamp_ns(message.header)
        if time_ns is not None:
            self._came_s[raw.topic] = time.monotonic()
            kind = self._clocks.setdefault(raw.topic, ClockOfStream()).take(time_ns, raw.log_time_ns)
            if kind == "stepped":
                self._begin_anew(raw.topic)
            time_ns = None if kind == "odd" else time_ns
        self._take(raw.topic, time_ns, message)
        self._num_new += 1
        if self._num_new >= _MOST_NEW:  # no image asks for them
            self._follow()

    def _take(self, topic: str, time_ns: int | None, message: Any) -> None:
        if self.unit is not None and topic == self.unit.name:
            self.unit.take(time_ns, message)
        elif self.barometer is not None and time_ns is not None:
            self.barometer.take(time_ns, float(message.fluid_pressure))

    def _begin_anew(self, topic: str) -> None:
        if self.unit is not None and topic == self.unit.name:
            self.unit.begin_anew()
            self.motion.begin_anew()
        elif self.barometer is not None:
            self.barometer.begin_anew()
            self.motion.lifts.begin_anew()

    def seen(self, frame: Frame, begin_ns: int | None) -> Frame:
        """See `MotionSensors.seen`."""
        self._follow()
        if self.unit is not None and self.unit.last_ns is not None:
            self._apart_s = (self.unit.last_ns - frame.time_ns) * 1e-9
        return self.motion.seen(frame, begin_ns)

    def _follow(self) -> None:
        """Give the samples that have come to what uses them, and forget old ones."""
        self._num_new = 0
        if self.unit is not None and (samples := self.unit.samples()) is not None:
            self.motion.extend(samples)
            self.motion.forget_before(int(samples.times_ns[-1]) - _KEPT_NS)
        barometer = self.barometer
        if barometer is not None and barometer.last_ns is not None and barometer.has_news():
            self.motion.extend(None, barometer.rides(goes_on=True))
            barometer.forget_before(barometer.last_ns - _PRESSURE_NS)

    @property
    def silent(self) -> list[str]:
        """Topics of sensors that say nothing, in words."""
        now_s = time.monotonic()
        return [
            f"no message on {name} for {_SILENT_S:g} s: images are without what it measures"
            for name in self.names
            if now_s - self._came_s.setdefault(name, now_s) > _SILENT_S
        ]

    @property
    def notices(self) -> list[str]:
        """Sentences for users, by the messages so far."""
        of_each = [notice for each in (self.unit, self.barometer) if each is not None for notice in each.notices]
        of_motions = self.motion.notices if self.motion.num_frames >= _ENOUGH_FRAMES else []
        return [*self._said, *of_each, *of_motions, *self._apart, *self.silent]

    @property
    def _apart(self) -> list[str]:
        """A sentence for users, where samples come, but hardly ever those of the time of an image."""
        unit, motion = self.unit, self.motion
        is_apart = not -_LATE_S < self._apart_s < _KEPT_NS * 1e-9
        if (
            unit is None
            or self.silent
            or not is_apart
            or 2 * motion.num_without < max(motion.num_frames, _ENOUGH_FRAMES)
        ):
            return []
        return [
            f"{unit.name}: its stamps are {self._apart_s:+.1f} s from those of the images, expected {-_LATE_S:g} s at"
            f" least: {motion.num_without} of {motion.num_frames} images have no gravity (another clock, a slow driver)"
        ]

    def values(self, gravity: Gravity | None) -> dict[str, object]:
        """Figures for diagnostics, by name; none without sensors.

        Args:
            gravity: Of the latest frame.
        """
        values: dict[str, object] = {}
        if self.unit is not None:
            bias = " ".join(f"{each:.4f}" for each in self.motion.gyroscope.bias)
            std = "unknown" if gravity is None else f"{np.degrees(gravity.std_rad):.2f}"
            values = {"gravity, standard deviation, deg": std, "bias of the gyroscope, rad/s": bias}
        if self.barometer is not None:
            values["rides in lifts"] = len(self.motion.lifts.rides)
        return values
