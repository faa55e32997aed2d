"""Which segment of a recording is asked for."""

from __future__ import annotations

from sequences.reading.clock_steps import SET_AHEAD_S
from sequences.reading.stamps import MAX_LATENESS_S
from sequences.recordings.source import RawMessage


class RequestedSegment:
    """The segment of a recording that is asked for, in seconds after its first image.

    Attributes:
        is_stopped: Whether no more frames are asked for.
    """

    def __init__(self, begin_ns: int, start_s: float, duration_s: float | None) -> None:
        """Set up a segment.

        Args:
            begin_ns: Stamp of the first image.
            start_s: How much later the segment begins.
            duration_s: How long it lasts; None: to the end.
        """
        self.is_stopped = False
        self._first_ns = begin_ns + round(start_s * 1e9) if start_s else None
        self._last_ns = None if duration_s is None else begin_ns + round((start_s + duration_s) * 1e9)

    def has(self, time_ns: int) -> bool:
        """Whether an image is of the segment; of video the first packet need not have the first image."""
        return (
            not self.is_stopped
            and (self._first_ns is None or time_ns >= self._first_ns)
            and not self.ends_before(time_ns)
        )

    def ends_before(self, time_ns: int) -> bool:
        """Whether all images from a time on lie behind the segment."""
        return self.is_stopped or (self._last_ns is not None and time_ns > self._last_ns)


class LoggedSegment:
    """The segment of a recording that is asked for, by the times at which its images were logged.

    Attributes:
        is_over: Whether all that comes lies too far behind it to be of it.
    """

    def __init__(self, image_topic: str, duration_s: float) -> None:
        """Set up a segment that lasts so long from the first image on."""
        self.is_over = False
        self._topic, self._until_ns = image_topic, round((duration_s + MAX_LATENESS_S) * 1e9)
        self._last_ns: int | None = None
        self._passed_ns = 0

    def take(self, raw: RawMessage) -> None:
        """Take the next message."""
        if raw.topic != self._topic:
            return
        since_ns = 0 if self._last_ns is None else raw.log_time_ns - self._last_ns
        self._last_ns = raw.log_time_ns
        if 0 <= since_ns <= SET_AHEAD_S * 1e9:  # else the clock of the log was set
            self._passed_ns += since_ns
        self.is_over = self._passed_ns > self._until_ns
