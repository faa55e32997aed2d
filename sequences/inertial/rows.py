"""Numbers with time stamps that come one after the other, as arrays."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64, Int64


class TimedRows:
    """Rows of numbers in increasing order of time; old ones may be forgotten."""

    def __init__(self, width: int) -> None:
        """No rows yet, each of which will have so many numbers."""
        self._times_ns: Int64[np.ndarray, " n"] = np.zeros(0, np.int64)
        self._rows: Float64[np.ndarray, "n width"] = np.zeros((0, width))
        self._new_ns: list[int] = []
        self._new: list[list[float]] = []

    def append(self, time_ns: int, row: list[float]) -> bool:
        """Take a row; False, and nothing taken, where it is not later than the one before."""
        last_ns = self.last_ns
        if last_ns is not None and time_ns <= last_ns:
            return False
        self._new_ns.append(time_ns)
        self._new.append(row)
        return True

    def extend(self, times_ns: Int64[np.ndarray, " m"], rows: Float64[np.ndarray, "m width"]) -> None:
        """Take rows that are later than those before."""
        self._join()
        self._times_ns, self._rows = np.concatenate([self._times_ns, times_ns]), np.concatenate([self._rows, rows])

    def forget_before(self, time_ns: int) -> None:
        """Drop what lies before the last row that is at or before this time."""
        keep = int(np.searchsorted(self.times_ns, time_ns, side="right")) - 1
        if keep > 0:
            self._times_ns, self._rows = self._times_ns[keep:].copy(), self._rows[keep:].copy()

    def __len__(self) -> int:
        return len(self._times_ns) + len(self._new)

    @property
    def last_ns(self) -> int | None:
        """The latest stamp; None where there is none."""
        if self._new_ns:
            return self._new_ns[-1]
        return int(self._times_ns[-1]) if len(self._times_ns) else None

    @property
    def times_ns(self) -> Int64[np.ndarray, " n"]:
        """Stamps, integer nanoseconds."""
        self._join()
        return self._times_ns

    @property
    def rows(self) -> Float64[np.ndarray, "n width"]:
        """The numbers."""
        self._join()
        return self._rows

    def _join(self) -> None:
        if self._new:
            new_ns, new = np.array(self._new_ns, np.int64), np.array(self._new)
            self._new_ns, self._new = [], []
            self._times_ns, self._rows = np.concatenate([self._times_ns, new_ns]), np.concatenate([self._rows, new])
