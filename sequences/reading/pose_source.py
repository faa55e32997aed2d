"""What gives poses of the camera over time, asked for one time after the other."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection
from types import SimpleNamespace
from typing import NamedTuple

from filtering.se3 import Poses

MAX_GAP_S = 0.25
MAX_STILL_GAP_S = 2.0


class Sample(NamedTuple):
    """One pose out of a message: of which link it is, its stamp, and itself."""

    link: tuple[str, str]
    time_ns: int
    pose: Poses


class Jumps(NamedTuple):
    """How many jumps there are, and when the first was over, integer nanoseconds."""

    number: int
    first_ns: int | None


class PoseSource(ABC):
    """Poses of the camera in one frame over time, taken in as a recording is read.

    Attributes:
        topic: Where its messages are; empty where all poses are known before, and none is taken in.
    """

    topic: str = ""

    @property
    def links(self) -> Collection[tuple[str, str]]:
        """The links of which messages say something; '' and a topic where its messages are of one."""
        return ()

    def samples(self, message: SimpleNamespace) -> tuple[list[Sample], list[str]]:
        """What a message says, and what is wrong with what cannot be used of it."""
        return [], []

    def append(self, sample: Sample) -> bool:
        """Take it in; False where it is earlier than the one before, or a second one of its time."""
        return True

    def reaches(self, time_ns: int) -> bool:
        """Whether everything there is to know about this time has been read."""
        return True

    def leads(self, start_ns: int, end_ns: int) -> bool:
        """Whether the motion between two covered times is known: without gaps and jumps."""
        return True

    def forget_before(self, time_ns: int) -> None:
        """Learn that no earlier time will be asked for."""
        return

    @abstractmethod
    def at(self, time_ns: int) -> Poses | None:
        """The camera's pose, one pose; None where it is not covered."""

    @abstractmethod
    def jumps_at(self, time_ns: int) -> bool:
        """Whether the pose at this time would be interpolated across a jump."""

    @abstractmethod
    def finish(self) -> Jumps:
        """All jumps, once no message comes any more."""

    @property
    @abstractmethod
    def span_ns(self) -> tuple[int, int] | None:
        """Stamps between which there are poses; None before any came."""
