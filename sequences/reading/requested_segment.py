"""Which segment of a recording is asked for."""

from __future__ import annotations

from sequences.reading.stamps import MAX_LATENESS_S


class RequestedSegment:
    """The segment of a recording that is asked for, in seconds after its first image.

    Attributes:
        is_stopped: Whether no more frames are asked for.
    """

    def __init__(self, start_s: float, duration_s: float | None) -> None:
        """Set up a segment that begins so late, and lasts so long, None: to the end."""
        self.is_stopped = False
        self._start_s, self._duration_s = start_s, duration_s
        self._begin: tuple[int, int] | None = None  # stamp and log time of the first image

    def take_image(self, time_ns: int, log_time_ns: int) -> None:
        """Learn of an image: the recording begins with the first."""
        self._begin = self._begin or (time_ns, log_time_ns)

    def has(self, time_ns: int) -> bool:
        """Whether an image is of the segment; of video the first packet need not have the first image."""
        assert self._begin is not None
        if self.is_stopped:
            return False
        since_s = (time_ns - self._begin[0]) * 1e-9 - self._start_s
        return (since_s >= 0 or self._start_s == 0) and (self._duration_s is None or since_s <= self._duration_s)

    def is_over(self, log_time_ns: int) -> bool:
        """Whether what is logged from a time on lies too far behind the segment to be of it."""
        if self.is_stopped:
            return True
        if self._duration_s is None or self._begin is None:
            return False
        since_s = (log_time_ns - self._begin[1]) * 1e-9
        return since_s > self._start_s + self._duration_s + MAX_LATENESS_S
