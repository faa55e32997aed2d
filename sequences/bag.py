"""MCAP files and rosbag2 folders: their topics, and a stream of raw messages in bounded memory."""

from __future__ import annotations

import io
import os
import struct
import zlib
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from mcap.reader import McapReader, NonSeekingReader, SeekingReader
from mcap.records import Channel, Message, Schema
from mcap.stream_reader import StreamReader

from sequences.errors import SequenceError

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
        type: Message type, as `nav_msgs/Odometry`.
        num_messages: How many messages it has, all files of the bag together.
        encoding: How messages are serialized; ROS 2 has "cdr".
    """

    name: str
    type: str
    num_messages: int
    encoding: str


@dataclass(frozen=True)
class RawMessage:
    """One message, not yet decoded: its topic, the time it was logged, and its bytes."""

    topic: str
    log_time_ns: int
    data: bytes


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

    def messages(self, topics: Collection[str]) -> Iterator[RawMessage]:
        """Messages of some topics: by log time within an indexed file, as written otherwise; file after file."""
        for file, indexed in self._indexed.items():
            with _reading(file) as stream:
                reader = _reader(stream, indexed)
                for _, channel, message in reader.iter_messages(topics=list(topics), log_time_order=indexed):
                    yield RawMessage(channel.topic, message.log_time, message.data)

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
            type_name = schemas[channel.schema_id].name if channel.schema_id in schemas else ""
            known = self.topics.get(channel.topic)
            count = counts.get(channel.id, 0) + (known.num_messages if known else 0)
            self.topics[channel.topic] = Topic(
                channel.topic, type_name.replace("/msg/", "/"), count, channel.message_encoding
            )


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


@contextmanager
def _reading(file: Path) -> Iterator[IO[bytes]]:
    """Open a file; whatever goes wrong in the library while reading becomes an error that names file and byte."""
    with open(file, "rb") as stream:
        try:
            yield stream
        except SequenceError:
            raise
        except Exception as error:  # the library lets struct, zstd, key and unicode errors of damaged files through
            reason = f"{type(error).__name__}: {error}".rstrip(": ")
            raise SequenceError(
                f"{file}: damaged MCAP near byte {stream.tell()}: {reason}; expected a readable record"
            ) from error


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
