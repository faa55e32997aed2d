"""What a reading leaves out, by reason."""

from __future__ import annotations

from collections import Counter

from sequences.reading.counts import ImageCounts


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

    def image(self, reason: str, time_ns: int, error: Exception | None = None) -> None:
        """Leave an image out."""
        self._note(reason, time_ns, error)
        self.counts.skipped[reason] += 1

    def message(self, reason: str, time_ns: int, error: Exception | None = None) -> None:
        """Leave a message out that is no image."""
        self._note(reason, time_ns, error)
        self.messages[reason] += 1

    def _note(self, reason: str, time_ns: int, error: Exception | None) -> None:
        if reason not in self.problems:
            self.problems[reason] = f" (first at {time_ns} ns{f': {error}' if error else ''})"
