"""The latest frames in the order of their times, and the motion of the camera from one to the next."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from typing import NamedTuple, Protocol, runtime_checkable

from filtering.motion import Odometry


@runtime_checkable
class KnownMotion(Protocol):
    """How a camera moved, as far as odometry has come."""

    def covers(self, time_ns: int) -> bool:
        """Whether the pose by odometry is known."""
        ...

    def odometry_between(self, start_ns: int, end_ns: int) -> Odometry | None:
        """Motion of the camera between two covered times; None where it is unknown."""
        ...

    def forget_before(self, time_ns: int) -> None:
        """Drop what only earlier times need."""
        ...


class _FrameTime(NamedTuple):
    time_ns: int  # of the frame
    taken_ns: int  # of its image
    covered: bool  # by odometry
    camera: str  # '' for a time without an image


def _taken_ns(frame: _FrameTime) -> int:
    return frame.taken_ns


class FrameTimes:
    """The frames that one to come may follow: those that a late image may come after, and the latest one.

    An image that is older than the latest frame by at most `late_ns` still becomes a frame; its motion, and that of
    the next one, is since the frame before it in time.

    Attributes:
        late_ns: See above.
    """

    def __init__(self, motion: KnownMotion, late_ns: int) -> None:
        self._motion, self.late_ns = motion, late_ns
        self._frames: list[_FrameTime] = []

    @property
    def latest_ns(self) -> int | None:
        """Latest time of a frame, or a later one given to `settle`; None before any."""
        return self._frames[-1].time_ns if self._frames else None

    @property
    def latest_taken_ns(self) -> int | None:
        """The same of the image of that frame."""
        return self._frames[-1].taken_ns if self._frames else None

    @property
    def earliest_ns(self) -> int:
        """Stamp from which on an image becomes a frame."""
        if not self._frames:
            return -(1 << 63)
        return max(self._frames[0].taken_ns, self._frames[-1].taken_ns - self.late_ns)

    def admits(self, taken_ns: int, camera: str) -> bool:
        """Whether an image becomes a frame: it is not too late, and the first one of its camera at its time."""
        known = self._frames[bisect_left(self._frames, taken_ns, key=_taken_ns) : self._after(taken_ns)]
        return taken_ns >= self.earliest_ns and all(frame.camera != camera for frame in known)

    def add(self, taken_ns: int, camera: str) -> int:
        """Add the frame of an image that is admitted; its time.

        Cameras take images at the same time; every frame has a time of its own, a nanosecond later.
        """
        at = self._after(taken_ns)
        time_ns = max([taken_ns, *(frame.time_ns + 1 for frame in self._frames[at - 1 : at])])
        self._frames.insert(at, _FrameTime(time_ns, taken_ns, self._motion.covers(taken_ns), camera))
        followed = bisect_left(self._frames, self._frames[-1].taken_ns - self.late_ns, key=_taken_ns) - 1
        del self._frames[: max(followed, 0)]
        self._motion.forget_before(self._frames[0].taken_ns)
        return time_ns

    def motion_until(self, taken_ns: int) -> Odometry | None:
        """Motion of the camera since the last frame that is not later, where odometry covers both; None elsewhere."""
        before = self._frames[: self._after(taken_ns)]
        if not before or not before[-1].covered or not self._motion.covers(taken_ns):
            return None
        return self._motion.odometry_between(before[-1].taken_ns, taken_ns)

    def moved_until(self, time_ns: int) -> Odometry | None:
        """Motion of the camera since the latest frame, for use between images; None where it is unknown."""
        return None if self.latest_ns is None or time_ns <= self.latest_ns else self.motion_until(time_ns)

    def settle(self, time_ns: int) -> None:
        """Begin the next motion there, as at a frame; earlier images are then too late."""
        self._frames = [_FrameTime(time_ns, time_ns, self._motion.covers(time_ns), "")]
        self._motion.forget_before(time_ns)

    def _after(self, taken_ns: int) -> int:
        return bisect_right(self._frames, taken_ns, key=_taken_ns)
