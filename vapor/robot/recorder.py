"""MCAP files of live localization: a recording of all messages, and snapshots."""

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
from sequences.atomic import atomic_output
from sequences.errors import SequenceError
from sequences.frame import Frame
from sequences.recordings.mcap_writer import CAMERA_FRAME, MessageChannels, ros_header
from sequences.recordings.message_definitions import encoder
from sequences.recordings.source import RawMessage

_MOST_WAITING = 256 * 2**20  # bytes
_INCOMPLETE = ".incomplete"
_IMAGE = "sensor_msgs/CompressedImage"


class MessageRecorder:
    """Writes messages to NAME.incomplete, renamed at the end of its `with` block.

    The file of a killed process is kept: the next recorder renames it to NAME.incomplete.1, and so on. A full disk
    ends the recording, not the localization.

    Attributes:
        number: Number of written messages.
        lost: Number of messages that were dropped, because the disk was too slow.
        error: Reason of an early end; None without one.

    Raises:
        SequenceError: the file exists, or cannot be written.
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
            if self._partial.exists():  # of a killed process
                names = (self._partial.with_name(f"{self._partial.name}.{n}") for n in count(1))
                self._partial.rename(next(name for name in names if not name.exists()))
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
        """Queue a message, or count it as lost."""
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
            self.error = f"{self.path}: recording ended: {error.strerror or error}; the part written is {self._partial}"
            while not self._waiting.empty() and self._waiting.get() is not None:
                self.lost += 1


def write_snapshot(folder: Path, frame: Frame, believed: Iterable[RawMessage]) -> Path:
    """Write an undistorted image, and the messages that were published of it.

    Raises:
        SequenceError, OSError: the file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"snapshot-{frame.time_ns}.mcap"
    messages = list(believed)
    now_ns = max((raw.log_time_ns for raw in messages), default=frame.time_ns)
    _, png = cv2.imencode(".png", cv2.cvtColor(frame.image, cv2.COLOR_RGB2BGR))
    of_camera = frame.camera_name.strip("/").replace("/", "_") or CAMERA_FRAME  # its mount is not in the snapshot
    image = {"header": ros_header(frame.time_ns, of_camera), "format": "png", "data": png.tobytes()}
    with atomic_output(path) as partial, open(partial, "wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2")
        channels = MessageChannels(writer)
        for raw in [RawMessage("/image", now_ns, encoder(_IMAGE)(image), _IMAGE, "cdr", b""), *messages]:
            channels.write(raw)
        writer.finish()
    return path
