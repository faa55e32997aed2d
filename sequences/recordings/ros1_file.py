"""One ROS 1 bag, read by the library `rosbags`."""

from __future__ import annotations

import io
from collections import Counter
from collections.abc import Iterator, Set
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, cast

from sequences.errors import SequenceError
from sequences.recordings.recording_file import Channel, Piece, RawRecord, RecordingFile

if TYPE_CHECKING:
    from rosbags.rosbag1 import Reader

MAGIC = b"#ROSBAG V"


class _BoundedFile(io.BufferedReader):
    """A file of which no more is asked than it has: what is asked gets memory, and damage may ask for any size."""

    def __init__(self, path: Path) -> None:
        super().__init__(io.FileIO(path))
        self._size = path.stat().st_size

    def read(self, size: int | None = -1) -> bytes:
        return super().read(size if size is None else min(size, max(0, self._size - self.tell())))


class _BoundedPath(type(Path())):
    """A path whose file is bounded."""

    def open(self, *_: Any, **__: Any) -> BinaryIO:  # pyright: ignore[reportIncompatibleMethodOverride]
        return cast(BinaryIO, _BoundedFile(self))


class Ros1File(RecordingFile):
    """One ROS 1 bag: opened, checked and listed. Its messages come in the order in which they were logged."""

    rescue = "`rosbag reindex` rescues what is readable"

    def __init__(self, path: Path) -> None:
        """Open a file. Raises SequenceError where it is truncated, damaged or without an index."""
        super().__init__(path)
        self.states_counts = True
        with self._reading() as reader:
            for connection in reader.connections:
                kind = connection.msgtype.replace("/msg/", "/").replace("tf/tfMessage", "tf2_msgs/TFMessage")
                self.channels[connection.id] = Channel(connection.topic, kind, "ros1", b"")
            for chunk in reader.chunk_infos:
                self.counts.update(chunk.connection_counts)

    @contextmanager
    def _reading(self) -> Iterator[Reader]:
        from rosbags.rosbag1 import Reader  # few recordings need it, and every command would pay for it

        try:
            reader = Reader(cast(Any, _BoundedPath(self.path)))
            with reader:
                yield reader
        except SequenceError:
            raise
        except Exception as error:  # damaged files raise struct, index, assertion, lz4 and unicode errors
            reason = f"{type(error).__name__}: {error}".rstrip(": ")
            raise SequenceError(
                f"{self.path}: damaged or unfinished ROS 1 bag: {reason}; expected one with an index ({self.rescue})"
            ) from error

    def _pieces(self, source: Reader) -> Iterator[Piece]:
        yield Piece(None, lambda ids: Counter(), partial(self._records, source))

    def _records(self, reader: Reader, ids: Set[int]) -> Iterator[RawRecord]:
        if asked := [connection for connection in reader.connections if connection.id in ids]:
            for connection, log_time_ns, data in reader.messages(asked):
                yield RawRecord(connection.id, log_time_ns, bytes(data))
