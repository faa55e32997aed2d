"""Time stamps of a recording's messages: from when to when they are, and which of them cannot be true."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from sequences.errors import SequenceError

MAX_LATENESS_S = 10.0
"""How much later than its stamp a message may be logged, and how far clocks may jump ahead."""


@dataclass
class Stamps:
    """The messages of one topic: how many, the earliest and the latest stamp, and whether log times differ."""

    number: int = 0
    begin_ns: int = 0
    end_ns: int = 0
    first_log_ns: int = 0
    log_times_differ: bool = False

    def take(self, time_ns: int, log_time_ns: int) -> None:
        """Take in the stamp of a message and the time at which it was logged."""
        if self.number == 0:
            self.begin_ns = self.end_ns = time_ns
            self.first_log_ns = log_time_ns
        self.number += 1
        self.begin_ns, self.end_ns = min(self.begin_ns, time_ns), max(self.end_ns, time_ns)
        self.log_times_differ |= log_time_ns != self.first_log_ns

    def require_differing(self, path: Path, what: str) -> None:
        """Raise SequenceError where there are several messages, all with one and the same stamp."""
        if self.number < 2 or self.begin_ns != self.end_ns:
            return
        helps = "; --stamps log takes the times at which they were logged" if self.log_times_differ else ""
        said = "zero" if self.begin_ns == 0 else f"{self.begin_ns} ns"
        raise SequenceError(
            f"{path}: the time stamps in the headers of all {self.number} {what} are {said}, expected"
            f" increasing ones{helps}"
        )


class Clocks:
    """How far the clocks of the streams of a recording run ahead of its log."""

    def __init__(self) -> None:
        self._ahead_ns: dict[object, int] = {}  # stream -> stamp less log time of its last usual message

    def jump_ahead(self, time_ns: int, log_time_ns: int, stream: object) -> bool:
        """Whether a stamp ran ahead of its log time, by what is usual in its stream: all after it would seem late."""
        ahead_ns = time_ns - log_time_ns
        drift_ns = ahead_ns - self._ahead_ns.setdefault(stream, ahead_ns)
        if abs(drift_ns) <= MAX_LATENESS_S * 1e9:
            self._ahead_ns[stream] = ahead_ns  # clocks may drift apart slowly
        return drift_ns > MAX_LATENESS_S * 1e9


def odometry_apart(images: Stamps, odometry_ns: tuple[int, int] | None) -> str | None:
    """What to say where odometry is of another time than all images: by another clock. None elsewhere.

    Args:
        images: Stamps of the images.
        odometry_ns: First and last stamp of the odometry; None where there is none.
    """
    span = odometry_ns
    if span is None or not images.number or (span[0] <= images.end_ns and images.begin_ns <= span[1]):
        return None
    return (
        f"images run from {_seconds(images.begin_ns)} to {_seconds(images.end_ns)} s, odometry from"
        f" {_seconds(span[0])} to {_seconds(span[1])} s: they begin {abs(span[0] - images.begin_ns) * 1e-9:.1f} s"
        " apart, expected one clock (--stamps log takes log times)"
    )


def true_poses_apart(said: str, poses_ns: tuple[int, int] | None, frames_ns: tuple[int, int]) -> str:
    """What to say where there are true poses, but none of the time of an image.

    Args:
        said: What the true poses are.
        poses_ns: First and last stamp of the poses; None where there are none.
        frames_ns: First and last stamp of the frames.
    """
    span, (begin, end) = poses_ns, frames_ns
    when = "no pose" if span is None else f"from {_seconds(span[0])} to {_seconds(span[1])} s"
    return (
        f"no image with a true pose: those of {said} are {when}, images from {_seconds(begin)} to"
        f" {_seconds(end)} s; expected poses of that time, without long gaps (--time-offset-s shifts a file's)"
    )


def jumps_of_true_poses(said: str, number: int, first_ns: int, num_images: int) -> str:
    """What to say of true poses that jump.

    Args:
        said: What they are.
        number: How many times they jump.
        first_ns: When they first did.
        num_images: How many images lie between two poses with a jump between them.
    """
    return (
        f"true poses of {said} jump {number} times, first at {_seconds(first_ns)} s: {num_images} images between have"
        " none"
    )


def _seconds(time_ns: int) -> str:
    return f"{time_ns * 1e-9:.3f}"
