"""MCAP files of live localization: everything that comes, for which it never waits, and one moment when asked for."""

from __future__ import annotations

import os
import queue
import threading
from collections.abc import Iterable
from itertools import count
from pathlib import Path
from types import TracebackType

import cv2
from mcap.writer import CompressionType, Writer

from filtering.errors import quoted
from sequences.errors import SequenceError
from sequences.frame import Frame
from sequences.recordings.mcap_writer import CAMERA_FRAME, MessageChannels, MessageWriter, ros_header
from sequences.recordings.source import RawMessage

_MOST_WAITING = 256 * 2**20  # bytes
_INCOMPLETE = ".incomplete"
_IMAGE = "sensor_msgs/CompressedImage"


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


class _Snapshot(MessageWriter):
    def __enter__(self) -> _Snapshot:
        self._open()
        return self

    def write(self, frame: Frame, believed: Iterable[RawMessage]) -> None:
        messages = list(believed)
        now_ns = max((raw.log_time_ns for raw in messages), default=frame.time_ns)
        _, png = cv2.imencode(".png", cv2.cvtColor(frame.image, cv2.COLOR_RGB2BGR))
        header = ros_header(frame.time_ns, CAMERA_FRAME)
        self._write("/image", _IMAGE, {"header": header, "format": "png", "data": png.tobytes()}, now_ns)
        for raw in messages:
            self._channels.write(raw)


def write_snapshot(folder: Path, frame: Frame, believed: Iterable[RawMessage]) -> Path:
    """Write the image, undistorted as the network saw it, and the messages that were published of it.

    Raises:
        SequenceError, OSError: the file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"snapshot-{frame.time_ns}.mcap"
    with _Snapshot(path) as snapshot:
        snapshot.write(frame, believed)
    return path
