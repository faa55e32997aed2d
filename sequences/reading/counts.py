"""How many images a recording states, what became of each, and what else a reading leaves out."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Int64

from sequences.trajectories.interpolation import MAX_ODOMETRY_GAP_S

OUTSIDE = "outside the stretch asked for"
BEFORE, AFTER = "before odometry begins", "after odometry ends"
IN_GAP = f"in a gap of odometry over {MAX_ODOMETRY_GAP_S:g} s"
NOT_COME = "odometry had not come yet"  # to a running system: of a recording, odometry is read as far as it has to be
OVERTAKEN = "a newer image was there"
NO_ESTIMATE = "no estimate"  # of others: frames that their files leave out
ODD = "time stamp unlike those before"
NOT_INCREASING = "time stamp not increasing"
BETWEEN = "between the images localized"  # whose odometry is used
_NOT_ASKED = (OUTSIDE, NO_ESTIMATE, BETWEEN)
_FEW, _VERY_FEW = 0.5, 0.1  # fractions of the images asked for


def uncovered(time_ns: int, odometry_ns: Int64[np.ndarray, " n"] | tuple[int, int] | None) -> str:
    """The reason to count where odometry of such stamps (in order) does not cover a time."""
    if odometry_ns is None or time_ns > odometry_ns[-1]:
        return AFTER
    return BEFORE if time_ns < odometry_ns[0] else IN_GAP


@dataclass
class ImageCounts:
    """Images of one reading. Once it is complete, `stated` is `used` plus all of `skipped`, by reason.

    `stated` is counted where the file makes no statement. Fewer are `read` where reading ended behind the segment.
    """

    stated: int
    read: int = 0
    used: int = 0
    skipped: Counter[str] = field(default_factory=Counter)

    @property
    def are_complete(self) -> bool:
        """Whether all images are accounted for; not where the reading was abandoned."""
        return self.stated == self.used + self.skipped.total()

    @property
    def are_very_few(self) -> bool:
        """Whether fewer than one in ten of the images asked for were used."""
        return self.are_complete and self.used < _VERY_FEW * self._asked

    @property
    def warning(self) -> str | None:
        """A sentence where fewer than half of the images asked for were used, with the main reason; None elsewhere."""
        if not self.are_complete or self.used >= _FEW * self._asked:
            return None
        lost = Counter({reason: number for reason, number in self.skipped.items() if reason not in _NOT_ASKED})
        ((reason, number),) = lost.most_common(1)
        lost_are = f"{number} was" if number == 1 else f"{number} were"
        return f"Only {self.used} of {self._asked} images were used: {lost_are} skipped: {reason}."

    def taken(self, number: int) -> ImageCounts:
        """The same where only so many frames were taken, and no others asked for."""
        others = self.stated - number - self.skipped.total()
        return replace(self, used=number, skipped=self.skipped + Counter({OUTSIDE: others}))

    def __add__(self, other: ImageCounts) -> ImageCounts:
        return ImageCounts(
            self.stated + other.stated, self.read + other.read, self.used + other.used, self.skipped + other.skipped
        )

    def as_json(self) -> dict[str, Any]:
        """For a report."""
        return {**vars(self), "skipped": dict(sorted(self.skipped.items()))}

    @property
    def _asked(self) -> int:
        return self.stated - sum(self.skipped[reason] for reason in _NOT_ASKED)


class SkipCounter:
    """Images and other messages that one reading leaves out, by reason.

    `problems` has time and problem of the first of each reason, to end a sentence with.
    """

    def __init__(self, num_images: int) -> None:
        self.counts = ImageCounts(num_images)
        self.messages: Counter[str] = Counter()
        self.problems: dict[str, str] = {}

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
