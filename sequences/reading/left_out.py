"""What a reading leaves out, by reason."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from sequences.errors import SequenceError
from sequences.reading.counts import ImageCounts

ODD = "time stamp unlike those before"
_MOST_UNUSABLE = 0.5


@dataclass
class Unusable:
    """How many messages of a topic, or poses in them, cannot be used: NaN, no rotation, bytes that are no message.

    Attributes:
        what: What they are, in the plural.
        topic: Where they are.
        total: How many there were so far, usable or not.
        number: How many could not be used.
        first: When that was first, and why, to end a sentence with.
    """

    what: str
    topic: str
    total: int = 0
    number: int = 0
    first: str = ""

    def note(self, time_ns: int, problem: str) -> None:
        """Count one that cannot be used."""
        self.number += 1
        self.first = self.first or f" (first at {time_ns} ns: {problem})"

    @property
    def notices(self) -> list[str]:
        """What a person should know of it."""
        return [f"{self.topic}: {self.said}: left out"] if self.number else []

    @property
    def said(self) -> str:
        """How many of how many cannot be used."""
        return f"{self.number} of {self.total} {self.what} cannot be used{self.first}"

    def require_few(self, path: Path) -> None:
        """Raise SequenceError where more cannot be used than can: nothing is to be made of the rest."""
        if self.number > _MOST_UNUSABLE * self.total:
            raise SequenceError(f"{path}: {self.topic}: {self.said}; expected at most one in two")


class LeftOut:
    """Images and other messages that one reading leaves out, and the first problem among them.

    Attributes:
        counts: What became of the images.
        messages: How many messages that are no images were left out, by reason.
        problems: Of each reason: when it was first given, and what the problem was, to end a message with.
    """

    def __init__(self, num_images: int) -> None:
        """Begin to count, of a recording that states so many images."""
        self.counts = ImageCounts(num_images)
        self.messages: Counter[str] = Counter()
        self.problems: dict[str, str] = {}

    @property
    def first_problem(self) -> str:
        """That of the first reason there was; '' where there was none."""
        return next(iter(self.problems.values()), "")

    def image(self, reason: str, time_ns: int, problem: str | None = None) -> None:
        """Leave an image out."""
        self._note(reason, time_ns, problem)
        self.counts.skipped[reason] += 1

    def message(self, reason: str, time_ns: int, problem: str | None = None) -> None:
        """Leave a message out that is no image."""
        self._note(reason, time_ns, problem)
        self.messages[reason] += 1

    def _note(self, reason: str, time_ns: int, problem: str | None) -> None:
        if reason not in self.problems:
            self.problems[reason] = f" (first at {time_ns} ns{f': {problem}' if problem else ''})"
