"""MCAP files and rosbag2 folders: their topics, and a stream of raw messages in bounded memory."""

from __future__ import annotations

import io
import os
import struct
import zlib
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import SimpleNamespace
from typing import IO

from mcap.reader import McapReader, NonSeekingReader, SeekingReader
from mcap.records import Channel, Message, Schema
from mcap.stream_reader import StreamReader

from sequences import encodings, foxglove
from sequences.errors import SequenceError
from sequences.messages import frame_name

TF_STATIC, TF = "/tf_static", "/tf"
_MAGIC = b"\x89MCAP0\r\n"
_FOREIGN = {
    b"#ROSBAG V": "a ROS 1 bag; convert it first, for example with `rosbags-convert --src IN.bag --dst OUT`",
    b"SQLite format 3": "a rosbag2 of SQLite storage; convert it first with `ros2 bag convert` to storage mcap",
}


@dataclass(frozen=True)
class Topic:
    """One topic of a bag.

    Attributes:
        name: Name of the topic.
        type: Message type as the file names it, without `/msg`: `nav_msgs/Odometry`, `foxglove.PoseInFrame`.
        num_messages: How many messages it has, all files of the bag together.
        encoding: How messages are serialized; ROS 2 has "cdr".
    """

    name: str
    type: str
    num_messages: int
    encoding: str

    @property
    def read_as(self) -> str:
        """The ROS 2 type whose fields its messages get."""
        return foxglove.read_as(self.type)

    @property
    def encodings(self) -> tuple[str, ...]:
        """The encodings in which its type is read."""
        return foxglove.encodings(self.type)

    @property
    def is_foxglove_tf(self) -> bool:
        """Whether it has transforms of Foxglove's, which may have any name, and stand for /tf and /tf_static."""
        return foxglove.is_transforms(self.type) and self.encoding in self.encodings


@dataclass(frozen=True)
class RawMessage:
    """One message, not yet decoded.

    Attributes:
        topic: The topic that was asked for: of Foxglove's transforms /tf or /tf_static.
        log_time_ns: The time it was logged.
        data: Its bytes.
        type: Its type, as of `Topic`.
        encoding: How it is serialized.
        definition: What the file says of its type.
    """

    topic: str
    log_time_ns: int
    data: bytes
    type: str
    encoding: str
    definition: bytes

    def decode(self) -> SimpleNamespace:
        """Its fields, named as in ROS 2. What it raises where it is damaged depends on the encoding."""
        return encodings.decoder(self.type, self.encoding, self.definition)(self.data)


class Bag:
    """One MCAP file, or a rosbag2 folder of one or several: opened, checked and listed.

    Files without an index (no summary section) are read from front to back once more to list their topics.

    Attributes:
        path: What was opened.
        topics: Topics by name.
        metadata: Metadata records by name, later ones over earlier ones; empty for files without an index.
    """

    def __init__(self, path: Path):
        """Open a bag. Raises SequenceError where a file is missing, truncated, garbage or of another format."""
        self.path = Path(path)
        self._indexed: dict[Path, bool] = {}
        self.topics: dict[str, Topic] = {}
        self.metadata: dict[str, dict[str, str]] = {}
        for file in bag_files(self.path):
            self._open(file)

    def __contains__(self, topic: str) -> bool:
        """Whether messages of a topic can be asked for."""
        return any(topic in self._stands_for(known) for known in self.topics.values())

    def messages(self, topics: Collection[str]) -> Iterator[RawMessage]:
        """Messages of some topics: by log time within an indexed file, as written otherwise; file after file.

        Those of Foxglove's transforms come once as /tf_static and once as /tf, where both are asked for.
        """
        asked = {t.name: [name for name in self._stands_for(t) if name in topics] for t in self.topics.values()}
        names = [name for name, stands_for in asked.items() if stands_for]
        for file, indexed in self._indexed.items():
            with _reading(file) as stream:
                reader = _reader(stream, indexed)
                for schema, channel, message in reader.iter_messages(topics=names, log_time_order=indexed):
                    type_name, definition = (_type_name(schema), schema.data) if schema is not None else ("", b"")
                    for name in asked[channel.topic]:
                        yield RawMessage(
                            name, message.log_time, message.data, type_name, channel.message_encoding, definition
                        )

    @cached_property
    def fixed_links(self) -> frozenset[tuple[str, str]]:
        """Parent and child of those of Foxglove's transforms that say the same from the first message to the last.

        Foxglove has no topic for what never changes; a transform that is told only once holds throughout.
        """
        first: dict[tuple[str, str], SimpleNamespace] = {}
        moving: set[tuple[str, str]] = set()
        if not any(topic.is_foxglove_tf for topic in self.topics.values()):
            return frozenset()
        for raw in self.messages([TF]):
            try:
                message = raw.decode()
            except Exception:  # said where it is used
                continue
            for stamped in message.transforms:
                link = link_of(stamped)
                if first.setdefault(link, stamped.transform) != stamped.transform:
                    moving.add(link)
        return frozenset(first.keys() - moving)

    @staticmethod
    def _stands_for(topic: Topic) -> tuple[str, ...]:
        return (TF_STATIC, TF) if topic.is_foxglove_tf else (topic.name,)

    def _open(self, file: Path) -> None:
        _check_ends(file)
        with _reading(file) as stream:
            _check_summary(file, stream)
            seeking = SeekingReader(stream, validate_crcs=True, record_size_limit=_size(stream))
            summary = seeking.get_summary()
            # What the library needs to seek: without channels it fails, without message indexes it may skip chunks.
            indexed = summary is not None and all(
                c.message_index_offsets and all(i in summary.channels for i in c.message_index_offsets)
                for c in summary.chunk_indexes
            )
            if summary is not None and indexed and summary.statistics and summary.chunk_indexes:
                schemas, channels = summary.schemas, summary.channels
                counts = summary.statistics.channel_message_counts
                self.metadata |= {record.name: record.metadata for record in seeking.iter_metadata()}
            else:
                indexed = False
                schemas, channels, counts = _list_by_reading(stream)
        self._indexed[file] = indexed
        for channel in channels.values():
            type_name = _type_name(schemas[channel.schema_id]) if channel.schema_id in schemas else ""
            known = self.topics.get(channel.topic)
            count = counts.get(channel.id, 0) + (known.num_messages if known else 0)
            self.topics[channel.topic] = Topic(channel.topic, type_name, count, channel.message_encoding)


def link_of(stamped: SimpleNamespace) -> tuple[str, str]:
    """Names of parent and child of geometry_msgs/TransformStamped."""
    return frame_name(stamped.header.frame_id), frame_name(stamped.child_frame_id)


def bag_files(path: Path) -> list[Path]:
    """The MCAP files of a file or rosbag2 folder, in their order. Raises SequenceError where there are none."""
    if path.is_file():
        return [path]
    if not path.is_dir():
        raise SequenceError(f"{path}: no such file or folder, expected an .mcap file or a rosbag2 folder")
    listing = path / "metadata.yaml"
    if not listing.is_file():
        raise SequenceError(f"{path}: folder has no metadata.yaml, expected an .mcap file or a rosbag2 folder")
    names = _relative_file_paths(listing.read_text(encoding="utf-8", errors="replace"))
    if not names:
        raise SequenceError(f"{listing}: names no files, expected `relative_file_paths:` with one or more .mcap files")
    for name in names:
        if not name.endswith(".mcap"):
            raise SequenceError(f"{listing}: names {name}, expected .mcap files (see `ros2 bag convert`)")
        if not (path / name).is_file():
            raise SequenceError(f"{listing}: names {name}, which is not in the folder")
    return [path / name for name in names]


def _relative_file_paths(text: str) -> list[str]:
    """The one list that is needed of a rosbag2's metadata.yaml, in the form in which rosbag2 writes it."""
    lines = iter(text.splitlines())
    for line in lines:
        if line.strip() == "relative_file_paths:":
            break
    names = []
    for line in lines:
        item = line.strip()
        if not item.startswith("- "):
            break
        names.append(item[2:].strip().strip("'\""))
    return names


def _check_ends(file: Path) -> None:
    """Both magics of an MCAP file: the second is missing where a recording was cut off."""
    with open(file, "rb") as stream:
        head = stream.read(16)
        size = stream.seek(0, os.SEEK_END)
        stream.seek(max(0, size - len(_MAGIC)))
        tail = stream.read()
    for start, what in _FOREIGN.items():
        if head.startswith(start):
            raise SequenceError(f"{file}: is {what}; expected an MCAP file")
    if not head.startswith(_MAGIC):
        raise SequenceError(f"{file}: starts with {head[:8]!r}, expected the MCAP magic {_MAGIC!r}")
    if tail != _MAGIC or size < 2 * len(_MAGIC):
        raise SequenceError(
            f"{file}: truncated: byte {size - len(_MAGIC)} of {size} is {tail!r}, expected the closing MCAP magic"
            f" (`mcap recover` rescues what is readable)"
        )


def _check_summary(file: Path, stream: IO[bytes]) -> None:
    """The checksum of the index, where there is one: the library does not compare it."""
    footer_size = 9 + 20 + len(_MAGIC)  # opcode and length, three numbers, magic
    start = stream.seek(-footer_size, os.SEEK_END)
    summary_start, _, checksum = struct.unpack("<9xQQI8x", stream.read(footer_size))
    begin = summary_start or start
    stream.seek(min(begin, start))
    matches = checksum in (0, zlib.crc32(stream.read(max(0, start + 25 - begin))))  # 0: written without one
    stream.seek(0)
    if begin > start or not matches:
        raise SequenceError(f"{file}: damaged MCAP: index from byte {begin} on does not match its checksum")


class _Bounded(io.BufferedReader):
    """A file of which no more is asked for than it has: for a damaged length, memory of that length would be taken."""

    def __init__(self, file: Path) -> None:
        super().__init__(io.FileIO(file))
        self._most = os.fstat(self.fileno()).st_size

    def read(self, size: int | None = -1, /) -> bytes:
        return super().read(self._most if size is None or size < 0 else min(size, self._most))


@contextmanager
def _reading(file: Path) -> Iterator[IO[bytes]]:
    """Open a file; whatever goes wrong in the library while reading becomes an error that names file and byte."""
    with _Bounded(file) as stream:
        try:
            yield stream
        except SequenceError:
            raise
        except Exception as error:  # the library lets struct, zstd, key and unicode errors of damaged files through
            reason = f"{type(error).__name__}: {error}".rstrip(": ")
            raise SequenceError(
                f"{file}: damaged MCAP near byte {stream.tell()}: {reason}; expected a readable record"
            ) from error


def _type_name(schema: Schema) -> str:
    return schema.name.replace("/msg/", "/")


def _reader(stream: IO[bytes], indexed: bool) -> McapReader:
    kind = SeekingReader if indexed else NonSeekingReader
    return kind(stream, validate_crcs=True, record_size_limit=_size(stream))


def _list_by_reading(stream: IO[bytes]) -> tuple[dict[int, Schema], dict[int, Channel], dict[int, int]]:
    """Schemas, channels and message counts of a file without an index."""
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    counts: dict[int, int] = {}
    stream.seek(0)
    for record in StreamReader(stream, validate_crcs=True, record_size_limit=_size(stream)).records:
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            channels[record.id] = record
        elif isinstance(record, Message):
            counts[record.channel_id] = counts.get(record.channel_id, 0) + 1
    return schemas, channels, counts


def _size(stream: IO[bytes]) -> int:
    """Size of an open file, the limit that keeps a damaged length from asking for gigabytes."""
    position = stream.tell()
    size = stream.seek(0, io.SEEK_END)
    stream.seek(position)
    return size
