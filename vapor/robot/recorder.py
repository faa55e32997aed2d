"""Everything that comes, into an MCAP file: written beside the localization, which never waits for a disk."""

from __future__ import annotations

import os
import queue
import threading
from itertools import count
from pathlib import Path
from types import TracebackType

from mcap.writer import CompressionType, Writer

from filtering.errors import quoted
from sequences.errors import SequenceError
from sequences.recordings.mcap_writer import MessageChannels
from sequences.recordings.source import RawMessage

_MOST_WAITING = 256 * 2**20  # bytes
_INCOMPLETE = ".incomplete"


class MessageRecorder:
    """Writes messages as they are; used in a `with` block, at whose end the file gets its name.

    Until then it is called NAME.incomplete, and of a process that was killed that remains: a recording of a robot is
    not thrown away, and the next one of that name calls it NAME.incomplete.1, and so on. A full disk ends the
    recording, not the localization.

    Attributes:
        number: How many messages were written.
        lost: How many messages were not, as the disk was too slow.
        error: What ended the recording early; None where nothing did.

    Raises:
        SequenceError: the file is there already, or cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.number = self.lost = 0
        self.error: str | None = None
        self._partial = path.with_name(path.name + _INCOMPLETE)
        if path.exists():
            raise SequenceError(f"{quoted(str(path))} exists, expected the name of a new recording")
        if not path.parent.is_dir():
            raise SequenceError(f"{path}: cannot write, expected the folder {path.parent} to exist")
        try:
            _put_aside(self._partial)
            self._file = self._partial.open("xb")
        except OSError as error:
            raise SequenceError(f"{path}: cannot write: {error.strerror or error}") from error
        # Images are compressed already, or too large to be compressed at the rate of a camera.
        self._writer = Writer(self._file, compression=CompressionType.NONE)
        self._waiting: queue.SimpleQueue[RawMessage | None] = queue.SimpleQueue()
        self._bytes = 0
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._work, name="recorder", daemon=True)
        self._thread.start()

    def __enter__(self) -> MessageRecorder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def write(self, raw: RawMessage) -> None:
        """Take a message; it is written soon, or counted as lost."""
        if self.error is not None or self._bytes > _MOST_WAITING:
            self.lost += 1
            return
        with self._lock:
            self._bytes += len(raw.data)
        self._waiting.put(raw)

    def close(self) -> None:
        """Write what waits; the file gets its name."""
        self._waiting.put(None)
        self._thread.join()
        with self._file:
            if self.error is None:
                os.replace(self._partial, self.path)

    def _work(self) -> None:
        try:
            self._writer.start(profile="ros2")
            channels = MessageChannels(self._writer)
            while (raw := self._waiting.get()) is not None:
                channels.write(raw)
                self.number += 1
                with self._lock:
                    self._bytes -= len(raw.data)
            self._writer.finish()
        except OSError as error:
            self.error = f"{self.path}: recording ended: {error.strerror or error}; what was written is {self._partial}"
            while not self._waiting.empty() and self._waiting.get() is not None:
                self.lost += 1


def _put_aside(left: Path) -> None:
    """Give what a killed process left a number. Raises OSError where that cannot be."""
    if left.exists():
        number = next(n for n in count(1) if not left.with_name(f"{left.name}.{n}").exists())
        left.rename(left.with_name(f"{left.name}.{number}"))
