"""The newest frame of a running system, with all that images and sensors say of its motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from filtering.errors import VaporTrackError
from filtering.motion import Odometry, joined
from sequences.frame import Frame, Gravity
from sequences.inertial.motion_sensors import Up
from sequences.live.reader import LiveReader
from sequences.reading.counts import BETWEEN, OVERTAKEN
from sequences.visual_odometry.frames import VisualFrames

_MOST_WAITING = 16  # images whose features were tracked, of each camera


class LiveFrames:
    """Frames as `run` makes them, of a system that does not wait: the newest one whenever it is asked for.

    Odometry gets its fitted noise, then what the images show of the motion, then what a gyroscope and a barometer
    measured.

    Args:
        reader: The system.
        restated: Gives recorded odometry with its fitted noise; None for that which it states.
        visual: Begins to make odometry from images, at the first one and after a clock was set; None where images do
            not show the motion. Then images are taken in order, none of them late.
        usual_up: Up about the axes of the camera where no gravity is known, as of a robot.

    Attributes:
        reader: The system.
        gravity: Of the latest frame.
    """

    def __init__(
        self,
        reader: LiveReader,
        *,
        restated: Callable[[Odometry], Odometry] | None = None,
        visual: Callable[[], VisualFrames] | None = None,
        usual_up: Up | None = None,
    ) -> None:
        self.reader, self._restated, self._begin_visual = reader, restated, visual
        self.gravity: Gravity | None = None
        self._visual: VisualFrames | None = None
        self._reading, self._said = 0, dict[str, None]()
        self._tracked: list[Frame] = []  # in order, each with its motion since the one before
        self._before_ns: int | None = None  # stamp of the frame before these
        self._last_ns: dict[str, int] = {}  # stamp of the latest frame of each camera
        if visual is not None:
            reader.take_in_order()
        reader.sensors.begin(usual_up=usual_up, has_metres=reader.has_odometry)

    @property
    def makes_odometry(self) -> bool:
        """Whether images show the motion."""
        return self._begin_visual is not None

    def advance(self) -> None:
        """Take the images that have come, where they show the motion; to be called often."""
        if self._begin_visual is None:
            return
        if self._visual is None or self._reading != self.reader.readings:
            for _ in self._tracked:
                self.reader.give_up("clock was set")
            self._visual, self._reading = self._begin_visual(), self.reader.readings
            self._tracked, self._before_ns = [], None
        for frame in self.reader.ready_frames():
            visual, between = self._visual, self._visual.num_between
            try:
                self._tracked += visual.take(replace(frame, odometry=self._stated(frame.odometry)))
            except VaporTrackError as error:  # the next image begins anew
                self._visual, self._said = self._begin_visual(), {f"images do not show the motion: {error}": None}
                self.reader.give_up("unusable for visual odometry")
            for _ in range(visual.num_between - between):
                self.reader.give_up(BETWEEN)
        while len(self._tracked) > _MOST_WAITING * len(self.reader.lenses):
            self._drop_first()

    def _drop_first(self) -> None:
        """Leave out the oldest of the images that wait; its motion is part of the next one's."""
        first, second, *others = self._tracked
        whole = joined([first.odometry, second.odometry]) if self._before_ns is not None else None
        self._tracked = [replace(second, odometry=whole), *others]
        self.reader.give_up(OVERTAKEN)

    def newest(self) -> Frame | None:
        """See `LiveReader.newest_frame`."""
        if self._begin_visual is None:
            before_ns, frame = self.reader.frame_ns, self.reader.newest_frame()
            if frame is None:
                return None
            frame = replace(frame, odometry=self._stated(frame.odometry))
            if before_ns is not None and frame.time_ns < before_ns:  # it is late
                odometry = frame.odometry
                before_ns = None if odometry is None else frame.time_ns - round(odometry.duration_s * 1e9)
            return self._seen(frame, before_ns)
        self.advance()
        if not self._tracked:
            return None
        newest = {frame.camera_name: number for number, frame in enumerate(self._tracked)}
        turn = min(newest, key=lambda camera: self._last_ns.get(camera, -1))  # cameras take turns
        for _ in range(newest[turn]):
            self._drop_first()
        frame, before_ns = self._tracked.pop(0), self._before_ns
        self._before_ns = self._last_ns[turn] = frame.time_ns
        return self._seen(frame, before_ns)

    @property
    def notices(self) -> list[str]:
        """Sentences for users, by the images so far."""
        return [*self._said, *([] if self._visual is None else self._visual.disagreement)]

    def _seen(self, frame: Frame, before_ns: int | None) -> Frame:
        frame = self.reader.sensors.seen(frame, before_ns)
        self.gravity = frame.gravity
        return frame

    def moved_until(self, time_ns: int) -> Odometry | None:
        """Motion of the camera since the last frame, by recorded odometry, for use between images.

        It is no motion where the time is not later than that frame, and None where it is unknown.
        """
        begin_ns = self.reader.frame_ns
        is_later = begin_ns is not None and time_ns > begin_ns
        since = self._stated(self.reader.moved_until(time_ns)) if is_later else Odometry.still()
        if self._visual is None:
            return since
        return joined([*(frame.odometry for frame in self._tracked), self._visual.since, since])

    def settle(self, time_ns: int) -> None:
        """Begin the next motion at a time with odometry, as at a frame."""
        self.reader.settle(time_ns)
        if self._visual is not None:
            self._visual.settle()
            self._tracked, self._before_ns = [], time_ns

    def _stated(self, odometry: Odometry | None) -> Odometry | None:
        return odometry if odometry is None or self._restated is None else self._restated(odometry)
