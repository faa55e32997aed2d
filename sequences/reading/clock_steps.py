"""Clocks that are set while messages come: by how far stamps run ahead of when they arrive."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Literal

STEP_S = 1.0
"""What stamps must differ by from those before for their clock to have been set."""
SET_AHEAD_S = 86_400.0
"""A log that jumps ahead by more was set: by less it may have been paused."""
_AGREE_S, _AGREE = 0.5, 3  # so many messages in a row that say the same of the clock
_REMEMBERED_NS = 30 * 10**9  # clocks drift apart slowly

Told = Literal["usual", "odd", "stepped"]


@dataclass
class ClockOfStream:
    """The clock behind the stamps of one topic.

    A stamp is odd that is more than a second before the latest one, or as much behind it while it also runs as much
    further ahead of its arrival than any of the last half minute. Three odd ones in a row that agree say that the clock
    was set. Messages that were held up on the way are late, but not odd: each follows the one before.
    """

    _end_ns: int | None = None
    _ahead_ns: deque[tuple[int, int]] = field(default_factory=deque)  # arrival and offset, the largest offset first
    _odd: list[tuple[int, int]] = field(default_factory=list)  # stamp and offset

    def take(self, time_ns: int, arrived_ns: int) -> Told:
        """Take a stamp; an odd one may turn out to be the first of a clock that was set."""
        offset_ns = time_ns - arrived_ns
        if not self._is_odd(time_ns, offset_ns):
            self._odd.clear()
            self._end_ns = time_ns if self._end_ns is None else max(self._end_ns, time_ns)
            self._remember(arrived_ns, offset_ns)
            return "usual"
        self._odd.append((time_ns, offset_ns))
        del self._odd[:-_AGREE]
        times, offsets = zip(*self._odd, strict=True)
        agree = len(times) == _AGREE and list(times) == sorted(set(times))
        if not agree or max(offsets) - min(offsets) > _AGREE_S * 1e9:
            return "odd"
        self._odd.clear()
        self._ahead_ns.clear()
        self._end_ns = time_ns
        self._remember(arrived_ns, offset_ns)
        return "stepped"

    def _is_odd(self, time_ns: int, offset_ns: int) -> bool:
        if self._end_ns is None:
            return False
        since_ns, further_ahead_ns = time_ns - self._end_ns, offset_ns - self._ahead_ns[0][1]
        return since_ns < -STEP_S * 1e9 or min(since_ns, further_ahead_ns) > STEP_S * 1e9

    def _remember(self, arrived_ns: int, offset_ns: int) -> None:
        """Keep the largest offset of the last half minute at hand: a queue that falls."""
        while self._ahead_ns and self._ahead_ns[-1][1] <= offset_ns:
            self._ahead_ns.pop()
        self._ahead_ns.append((arrived_ns, offset_ns))
        while len(self._ahead_ns) > 1 and arrived_ns - self._ahead_ns[0][0] > _REMEMBERED_NS:
            self._ahead_ns.popleft()
