"""One file of a recording, in any format: its channels, and a stream of raw messages in bounded memory.

The number of messages found is compared with the number that the file states.
"""

from __future__ import annotations

import io
import sqlite3
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Set
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, ClassVar, NamedTuple, cast

from filtering.errors import counted
from sequences.errors import SequenceError

if TYPE_CHECKING:
    from rosbags.rosbag1 import Reader

SUFFIXES = (".mcap", ".db3", ".bag")
SQLITE_MAGIC, ROS1_MAGIC = b"SQLite format 3\0", b"#ROSBAG V"


class Channel(NamedTuple):
    """The messages of one writer: their topic, type, encoding and the type's definition."""

    topic: str
    type: str
    encoding: str
    definition: bytes


class RawRecord(NamedTuple):
    """One message of a file: the channel's id, the time it was logged and its bytes."""

    channel_id: int
    log_time_ns: int
    data: bytes


class RecordingFile(ABC):
    """One file: opened, checked and listed.

    Attributes:
        counts: Messages of each channel, by id: as the file states, else as counted.
        states_counts: Whether the file states them.
        metadata: Metadata records by name, later ones over earlier ones.
    """

    rescue: ClassVar[str] = "record it again"
    """Advice where messages are missing."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.channels: dict[int, Channel] = {}
        self.counts: Counter[int] = Counter()
        self.states_counts = False
        self.metadata: dict[str, dict[str, str]] = {}

    def messages(
        self, topics: Collection[str], *, until: Callable[[int], bool] = lambda log_time_ns: False
    ) -> Iterator[RawRecord]:
        """Messages of some topics, in their order in the file; several iterators may run at once.

        The first message of a channel for whose log time `until` is true, and those behind it, are only counted. Raises
        SequenceError where the file is damaged, or has not the number of messages that it states.
        """
        asked = {id for id, channel in self.channels.items() if channel.topic in topics}
        wanted, found = set(asked), Counter[int]()
        for record in self._records(asked, wanted, found):
            id = record.channel_id
            found[id] += 1
            if id in wanted and until(record.log_time_ns):
                wanted.discard(id)
            elif id in wanted:
                yield record
        for id in sorted(asked):
            if found[id] != self.counts[id]:
                raise SequenceError(
                    f"{self.path}: {self.channels[id].topic}: {counted(found[id], 'message')} found where the file"
                    f" states {self.counts[id]}: it is damaged; expected all of them ({self.rescue})"
                )

    @abstractmethod
    def _records(self, asked: Set[int], wanted: Set[int], found: Counter[int]) -> Iterator[RawRecord]:
        """Messages of the channels that are asked for, in their order; any error of reading names the file.

        Messages of channels that are not `wanted` any more may be passed over, and are then added to `found`.
        """


class SqliteFile(RecordingFile):
    """One file of a rosbag2 of SQLite storage, as ROS 2 Humble records by default; its messages come by their ids.

    It states no number of messages beside the messages themselves, which SQLite keeps whole or not at all.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.states_counts = True
        with self._reading() as database:
            tables = {name for (name,) in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
            if not {"topics", "messages"} <= tables:
                raise SequenceError(f"{path}: SQLite without the tables `topics` and `messages`, expected a rosbag2")
            for id, *described in database.execute("SELECT id, name, type, serialization_format FROM topics"):
                name, kind, encoding = map(str, described)
                self.channels[id] = Channel(name, kind.replace("/msg/", "/"), encoding, b"")
            counted = database.execute("SELECT topic_id, count(*) FROM messages GROUP BY topic_id")
            self.counts = Counter({id: count for id, count in counted if id in self.channels})

    @contextmanager
    def _reading(self) -> Iterator[sqlite3.Connection]:
        # Without a log beside it nothing is written to the folder, which may be on a medium that refuses it.
        complete = "" if self.path.with_name(self.path.name + "-wal").exists() else "&immutable=1"
        address = f"{self.path.absolute().as_uri()}?mode=ro{complete}"
        try:
            # Iterators may go from thread to thread; none is used by two at a time.
            with closing(sqlite3.connect(address, uri=True, check_same_thread=False)) as database:
                database.execute("PRAGMA trusted_schema = OFF")
                yield database
        except (sqlite3.Error, ValueError, TypeError, OverflowError) as error:
            raise SequenceError(f"{self.path}: damaged SQLite: {error}; expected a readable rosbag2") from error

    def _records(self, asked: Set[int], wanted: Set[int], found: Counter[int]) -> Iterator[RawRecord]:
        listed = ",".join(str(int(id)) for id in sorted(asked))
        with self._reading() as database:
            rows = database.execute(
                f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({listed}) ORDER BY id"
            )
            for id, log_time_ns, data in rows:
                if not wanted:
                    found.update({each: self.counts[each] - found[each] for each in asked})
                    return
                if not (isinstance(log_time_ns, int) and isinstance(data, bytes)):
                    raise ValueError(f"a message of {self.channels[id].topic} has no time or no bytes")
                yield RawRecord(id, log_time_ns, data)


class _BoundedFile(io.BufferedReader):
    """A file that limits reads to its size: reads allocate memory first, and damage may ask for any size."""

    def __init__(self, path: Path) -> None:
        super().__init__(io.FileIO(path))
        self._size = path.stat().st_size

    def read(self, size: int | None = -1) -> bytes:
        return super().read(size if size is None else min(size, max(0, self._size - self.tell())))


class _BoundedPath(type(Path())):
    def open(self, *_: Any, **__: Any) -> BinaryIO:  # pyright: ignore[reportIncompatibleMethodOverride]
        return cast(BinaryIO, _BoundedFile(self))


class Ros1File(RecordingFile):
    """One ROS 1 bag, read by the library `rosbags`; its messages come in the order in which they were logged."""

    rescue = "`rosbag reindex` rescues what is readable"

    def __init__(self, path: Path) -> None:
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

    def _records(self, asked: Set[int], wanted: Set[int], found: Counter[int]) -> Iterator[RawRecord]:
        with self._reading() as reader:
            # Without connections the library would read all of them.
            if connections := [connection for connection in reader.connections if connection.id in asked]:
                for connection, log_time_ns, data in reader.messages(connections):
                    yield RawRecord(connection.id, log_time_ns, bytes(data))
