"""Rows of a Rerun recording, sent many images at once: a call of Rerun takes as long for one row as for many."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Int64

if TYPE_CHECKING:
    import rerun as rr

_EPOCH_NS = 10**17  # stamps below are seconds since some start, not since 1970


class Rows:
    """Collects what is to be shown of each image, until it is sent.

    Args:
        stream: Where to.
        images: After how many images they are sent; 1 where somebody watches.
    """

    def __init__(self, stream: rr.RecordingStream, images: int) -> None:
        self._stream, self._images = stream, images
        self._times_ns: list[int] = []
        self._rows: dict[tuple[str, Any], list[tuple[int, dict[str, Any]]]] = {}

    def begin(self, time_ns: int) -> None:
        """Go on to the next image."""
        if len(self._times_ns) >= self._images:
            self.send()
        self._times_ns.append(time_ns)

    def add(self, entity: str, archetype: Any, **components: Any) -> None:
        """Add a row of this image.

        Args:
            entity: Path of what is shown.
            archetype: Its kind, such as `rerun.Points3D`.
            components: Their values by name, an instance of each per point, line or other thing shown.
        """
        self._rows.setdefault((entity, archetype), []).append((self._times_ns[-1], components))

    def send(self) -> None:
        """Send all rows."""
        rows, self._rows, self._times_ns = self._rows, {}, []
        for (entity, archetype), each in rows.items():
            values = {name: [components[name] for _, components in each] for name in each[0][1]}
            lengths = [len(value) for value in next(iter(values.values()))]
            columns = archetype.columns(**{name: _joined(value) for name, value in values.items()}).partition(lengths)
            times = time_column(np.array([time_ns for time_ns, _ in each], np.int64))
            self._stream.send_columns(entity, [times], columns)


def _joined(values: list[Any]) -> Any:
    if isinstance(values[0], np.ndarray):
        return np.concatenate(values)
    return [item for value in values for item in value]


def time_column(times_ns: Int64[np.ndarray, " n"]) -> rr.TimeColumn:
    """The times of rows, since 1970 or some other start."""
    import rerun as rr

    if times_ns[0] >= _EPOCH_NS:
        return rr.TimeColumn("time", timestamp=times_ns.astype("datetime64[ns]"))
    return rr.TimeColumn("time", duration=times_ns.astype("timedelta64[ns]"))
