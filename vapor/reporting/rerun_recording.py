"""Rerun recordings: a file that is whole or absent, and rows sent many images at once."""

from __future__ import annotations

import os
import shutil
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Int64

from filtering.errors import VaporTrackError
from sequences.atomic import atomic_output

if TYPE_CHECKING:
    import rerun as rr

_MAGIC = b"RRF2"


class Recording:
    """A file that Rerun writes through a pipe, as Rerun itself would hang on a full disk.

    `error`: why the file could not be written; None while it can.

    Raises:
        SequenceError: the folder is missing or cannot be written to.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._output = atomic_output(path)
        partial = self._output.__enter__()
        pipe, self._end = os.pipe()
        self.pipe = f"/dev/fd/{self._end}"
        self.error: VaporTrackError | None = None
        self._thread = threading.Thread(target=self._copy, args=(pipe, partial), daemon=True)
        self._thread.start()

    def _copy(self, pipe: int, partial: Path) -> None:
        with open(pipe, "rb") as stream:
            try:
                with partial.open("wb") as file:
                    shutil.copyfileobj(stream, file)
            except OSError as error:
                self.error = VaporTrackError(
                    f"{self._path}: the recording cannot be written: {error.strerror or error}; expected room for it on"
                    " the disk, a run with --no-recording needs none"
                )
            while stream.read(1 << 16):  # so that Rerun does not wait for room in the pipe
                pass

    def close(self, *, keep: bool) -> None:
        """Give the file its name, or remove it, once Rerun has closed the pipe.

        Raises:
            VaporTrackError: the file was to be kept, and could not be written.
        """
        os.close(self._end)
        self._thread.join()
        failed = self.error or (None if keep else VaporTrackError("the run failed"))
        self._output.__exit__(failed and type(failed), failed, None)
        if keep and failed:
            raise failed


@contextmanager
def recorded(path: Path, application: str, title: str) -> Iterator[rr.RecordingStream]:
    """A stream of Rerun into a file, `.rrd`, which appears under its name at the end of the block, and after no error.

    Recordings of one application share layout and panels in the viewer; the title is the name there.

    Raises:
        SequenceError: the folder is missing or cannot be written to.
        VaporTrackError: it could not be written.
    """
    rr = load_rerun()
    recording, keep = Recording(path), False
    stream = rr.RecordingStream(application, recording_id=title)
    try:
        stream.set_sinks(rr.FileSink(recording.pipe))
        yield stream
        stream.flush()
        keep = True
    finally:
        stream.disconnect()
        recording.close(keep=keep)


def is_recording(path: Path) -> bool:
    """Whether a file is a recording of Rerun."""
    with path.open("rb") as file:
        return file.read(len(_MAGIC)) == _MAGIC


def load_rerun() -> ModuleType:
    """Import Rerun, which takes a while, with its own error log off: errors are reported here."""
    level = os.environ.get("RUST_LOG")
    os.environ["RUST_LOG"] = level or "off"  # read when it is imported
    try:
        import rerun
        import rerun.blueprint

        return rerun
    finally:
        if level is None:
            del os.environ["RUST_LOG"]


_EPOCH_NS = 10**17  # stamps below are seconds since some start, not since 1970


class Rows:
    """Collects rows of each image, until they are sent.

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
        """Add a row of this image: an entity's archetype, such as `rerun.Points3D`, and its components by name."""
        self._rows.setdefault((entity, archetype), []).append((self._times_ns[-1], components))

    def send(self) -> None:
        """Send all rows."""
        rows, self._rows, self._times_ns = self._rows, {}, []
        for (entity, archetype), each in rows.items():
            values = {name: [components[name] for _, components in each] for name in each[0][1]}
            lengths = [len(value) for value in next(iter(values.values()))]
            joined = {
                name: np.concatenate(parts) if isinstance(parts[0], np.ndarray) else list(chain.from_iterable(parts))
                for name, parts in values.items()
            }
            columns = archetype.columns(**joined).partition(lengths)
            times = time_column(np.array([time_ns for time_ns, _ in each], np.int64))
            self._stream.send_columns(entity, [times], columns)


def time_column(times_ns: Int64[np.ndarray, " n"]) -> rr.TimeColumn:
    """The times of rows, since 1970 or some other start."""
    import rerun as rr

    if times_ns[0] >= _EPOCH_NS:
        return rr.TimeColumn("time", timestamp=times_ns.astype("datetime64[ns]"))
    return rr.TimeColumn("time", duration=times_ns.astype("timedelta64[ns]"))
