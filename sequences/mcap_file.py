"""One MCAP file: its channels, and a stream of raw messages in bounded memory.

The classes of the library say what a record holds. Reading is ours: sizes that a file states are checked against it and
against limits before memory is given to them, and the messages that come are counted against those that it states.
"""

from __future__ import annotations

import heapq
import os
import struct
import zlib
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Set
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import IO, NamedTuple, TypeVar

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    McapRecord,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)

from sequences.errors import SequenceError

_MAGIC = b"\x89MCAP0\r\n"
_FOREIGN = {
    b"#ROSBAG V": "a ROS 1 bag; convert it first, for example with `rosbags-convert --src IN.bag --dst OUT`",
    b"SQLite format 3": "a rosbag2 of SQLite storage; convert it first with `ros2 bag convert` to storage mcap",
}
_HEAD = struct.Struct("<BQ")  # of a record: opcode, length
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time; data follow
_MAX_CHUNK_BYTES = 1 << 28  # of one chunk, uncompressed
_MAX_HELD_BYTES = 1 << 29  # of messages of chunks that overlap in time
_MESSAGE_COSTS = 300  # bytes that a held message takes beside its data
_PIECE = 1 << 20

Record = TypeVar("Record", bound=McapRecord)


class RawRecord(NamedTuple):
    """One message as it lies in a file: the channel's id, the time it was logged and its bytes."""

    channel_id: int
    log_time_ns: int
    data: bytes


class McapFile:
    """One MCAP file: opened, checked and listed.

    Files without a usable index (no summary section) are read from front to back once more to list their channels.

    Attributes:
        path: What was opened.
        schemas: Schemas by id.
        channels: Channels by id.
        counts: How many messages each channel has, by id: as the file states it, where it does, else as counted.
        states_counts: Whether the file itself states how many messages it has.
        metadata: Metadata records by name, later ones over earlier ones; empty for files without an index.
    """

    def __init__(self, path: Path):
        """Open a file. Raises SequenceError where it is truncated, garbage or of another format."""
        self.path = path
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.metadata: dict[str, dict[str, str]] = {}
        self._chunks: list[ChunkIndex] = []
        _check_ends(path)
        with self._reading() as stream:
            summary_start = _check_summary(path, stream)
            statistics = self._read_summary(stream, summary_start) if summary_start else None
            # Reading by the index needs all channels, and which of them each chunk has.
            self._indexed = bool(statistics and self._chunks) and (
                all(
                    c.message_index_offsets and c.message_index_offsets.keys() <= self.channels.keys()
                    for c in self._chunks
                )
                and len({c.chunk_start_offset for c in self._chunks}) == len(self._chunks)
            )
            stated = statistics.channel_message_counts if statistics and statistics.channel_message_counts else None
            self.counts: Counter[int] = Counter(stated)
            if not self._indexed or stated is None:
                counted, by_indexes = self._list_by_reading(stream)
                self.counts = self.counts or by_indexes or counted
                stated = stated or by_indexes
            self.states_counts = bool(stated)

    def messages(
        self, topics: Collection[str], *, until: Callable[[int], bool] = lambda log_time_ns: False
    ) -> Iterator[RawRecord]:
        """Messages of some topics: by log time where there is an index, as written otherwise.

        Args:
            topics: Names of topics.
            until: Whether messages from a log time on are not wanted. They are counted all the same: by the indexes
                beside the chunks that were not opened, or else by reading on.

        Raises:
            SequenceError: the file is damaged; at the end, where there are fewer or more messages than it states.
        """
        asked = {id for id, channel in self.channels.items() if channel.topic in topics}
        found: Counter[int] = Counter()
        with self._reading() as stream:
            unopened: list[ChunkIndex] = []
            if self._indexed:
                unopened = self._chunks_of(asked)
                records = self._by_log_time(stream, asked, unopened, found)
            else:
                records = self._as_written(stream, asked, found)
            is_over = False
            for record in records:
                is_over = is_over or until(record.log_time_ns)
                if not is_over:
                    yield record
                elif self._indexed:
                    break
            for chunk in unopened:
                found += self._counted_beside(stream, chunk, asked)
        for id in sorted(asked):
            if found[id] != self.counts[id]:
                raise SequenceError(
                    f"{self.path}: {self.channels[id].topic}: {found[id]} messages found where the file states"
                    f" {self.counts[id]}: it is damaged; expected all of them (`mcap recover` rescues what is readable)"
                )

    @contextmanager
    def _reading(self) -> Iterator[IO[bytes]]:
        """Open the file; whatever goes wrong while reading becomes an error that names file and byte."""
        with open(self.path, "rb") as stream:
            try:
                yield stream
            except SequenceError:
                raise
            except Exception as error:  # damaged files raise struct, zstd, key and unicode errors
                reason = f"{type(error).__name__}: {error}".rstrip(": ")
                raise SequenceError(
                    f"{self.path}: damaged MCAP near byte {stream.tell()}: {reason}; expected a readable record"
                ) from error

    def _read_summary(self, stream: IO[bytes], start: int) -> Statistics | None:
        """Take in schemas, channels, metadata and indexes of chunks; what the file states of its size, if it does."""
        statistics = None
        stream.seek(start)
        places: list[int] = []
        for opcode, content in _records(stream):
            if opcode == Opcode.CHUNK_INDEX:
                self._chunks.append(_parsed(ChunkIndex, content))
            elif opcode == Opcode.METADATA_INDEX:
                places.append(_parsed(MetadataIndex, content).offset)
            elif opcode == Opcode.STATISTICS:
                statistics = _parsed(Statistics, content)
            else:
                self._list(opcode, content)
        for place in places:
            record = _parsed(Metadata, _record_at(stream, place, Opcode.METADATA))
            self.metadata[record.name] = record.metadata
        return statistics

    def _list(self, opcode: int, content: bytes | memoryview) -> None:
        """Take in a schema or a channel."""
        if opcode == Opcode.SCHEMA:
            schema = _parsed(Schema, content)
            self.schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = _parsed(Channel, content)
            self.channels[channel.id] = channel

    def _list_by_reading(self, stream: IO[bytes]) -> tuple[Counter[int], Counter[int]]:
        """Read all for schemas and channels: how many messages came, and how many the indexes beside chunks state."""
        found: Counter[int] = Counter()
        stated: Counter[int] = Counter()
        stream.seek(0)
        for opcode, content in _with_chunks_opened(stream):
            if opcode == Opcode.MESSAGE:
                found[_MESSAGE.unpack_from(content)[0]] += 1
            elif opcode == Opcode.MESSAGE_INDEX:
                index = _parsed(MessageIndex, content)
                stated[index.channel_id] += len(index.records)
            else:
                self._list(opcode, content)
        return found, stated

    def _chunks_of(self, asked: Set[int]) -> list[ChunkIndex]:
        """The chunks that have some of the channels asked for, the earliest last."""
        chunks = [c for c in self._chunks if not c.message_index_offsets.keys().isdisjoint(asked)]
        return sorted(chunks, key=lambda c: (c.message_start_time, c.chunk_start_offset), reverse=True)

    def _counted_beside(self, stream: IO[bytes], chunk: ChunkIndex, asked: Set[int]) -> Counter[int]:
        """How many messages of the channels asked for a chunk has, by the indexes that lie beside it."""
        counts: Counter[int] = Counter()
        for id in asked & chunk.message_index_offsets.keys():
            index = _parsed(MessageIndex, _record_at(stream, chunk.message_index_offsets[id], Opcode.MESSAGE_INDEX))
            counts[index.channel_id] += len(index.records)
        return counts

    def _by_log_time(
        self, stream: IO[bytes], asked: Set[int], unopened: list[ChunkIndex], found: Counter[int]
    ) -> Iterator[RawRecord]:
        """Messages of chunks, which are taken from the end of a list, opened and counted when their time has come."""
        held: list[tuple[int, int, int, RawRecord]] = []
        num_bytes = 0

        def ready(until_ns: int) -> Iterator[RawRecord]:
            nonlocal num_bytes
            while held and held[0][0] < until_ns:
                record = heapq.heappop(held)[-1]
                num_bytes -= len(record.data) + _MESSAGE_COSTS
                yield record

        while unopened:
            yield from ready(unopened[-1].message_start_time)
            index = unopened.pop()
            chunk = _record_at(stream, index.chunk_start_offset, Opcode.CHUNK)
            for number, (opcode, content) in enumerate(_opened(chunk)):
                if opcode == Opcode.MESSAGE and (record := self._asked_for(content, asked, found)) is not None:
                    heapq.heappush(held, (record.log_time_ns, index.chunk_start_offset, number, record))
                    num_bytes += len(record.data) + _MESSAGE_COSTS
                    if num_bytes > _MAX_HELD_BYTES:
                        raise McapError(f"chunks overlap in time by more than {_MAX_HELD_BYTES} bytes of messages")
        yield from ready(1 << 64)  # no log time is later

    def _as_written(self, stream: IO[bytes], asked: Set[int], found: Counter[int]) -> Iterator[RawRecord]:
        for opcode, content in _with_chunks_opened(stream):
            if opcode == Opcode.MESSAGE and (record := self._asked_for(content, asked, found)) is not None:
                yield record

    def _asked_for(self, content: bytes | memoryview, asked: Set[int], found: Counter[int]) -> RawRecord | None:
        """A message, counted; None where its channel is not asked for."""
        channel_id, _, log_time_ns, _ = _MESSAGE.unpack_from(content)
        if channel_id not in self.channels:
            raise McapError(f"a message of channel {channel_id}, which is not listed")
        if channel_id not in asked:
            return None
        found[channel_id] += 1
        return RawRecord(channel_id, log_time_ns, bytes(content[_MESSAGE.size :]))


def _with_chunks_opened(stream: IO[bytes]) -> Iterator[tuple[int, bytes | memoryview]]:
    """Records of a file from its beginning on, with those within chunks in their place."""
    for opcode, content in _records(stream):
        if opcode == Opcode.CHUNK:
            yield from _opened(content)
        else:
            yield opcode, content


def _records(stream: IO[bytes]) -> Iterator[tuple[int, bytes]]:
    """Opcode and content of each record from where a stream stands up to the footer; without attachments.

    From the beginning of the file on, the checksum of the data section is compared, where there is one.
    """
    start = stream.tell()
    size = stream.seek(0, os.SEEK_END)
    stream.seek(start)
    checksum = zlib.crc32(stream.read(len(_MAGIC))) if start == 0 else 0
    opcode = None
    while opcode != Opcode.FOOTER:
        head = stream.read(_HEAD.size)
        opcode, length = _HEAD.unpack(head)
        if length > size - stream.tell():
            raise McapError(f"record of {length} bytes, which is beyond the end of the file")
        if opcode == Opcode.ATTACHMENT:  # of any size, and nobody asks for it
            checksum = zlib.crc32(head, checksum)
            for at in range(0, length, _PIECE):
                checksum = zlib.crc32(stream.read(min(_PIECE, length - at)), checksum)
            continue
        content = stream.read(length)
        if opcode == Opcode.FOOTER and stream.tell() + len(_MAGIC) != size:
            raise McapError(f"footer with {size - stream.tell() - len(_MAGIC)} bytes behind it, expected it at the end")
        if opcode == Opcode.DATA_END and (stated := struct.unpack_from("<I", content)[0]) not in (0, checksum):
            raise McapError(f"data section has checksum {checksum}, expected {stated}")
        checksum = zlib.crc32(content, zlib.crc32(head, checksum))
        yield opcode, content


def _record_at(stream: IO[bytes], offset: int, opcode: int) -> bytes:
    """Content of the record of some kind at some place."""
    stream.seek(offset)
    found, content = next(_records(stream)) if offset else (None, b"")
    if found != opcode:
        raise McapError(f"no record of kind {opcode} at byte {offset}, where the index has one")
    return content


def _opened(chunk_content: bytes) -> Iterator[tuple[int, memoryview]]:
    """Opcode and content of each record within a chunk."""
    data = memoryview(_uncompressed(_parsed(Chunk, chunk_content)))
    at = 0
    while at < len(data):
        opcode, length = _HEAD.unpack_from(data, at)
        at += _HEAD.size
        if length > len(data) - at:
            raise McapError(f"record of {length} bytes, which is beyond the end of its chunk")
        yield opcode, data[at : at + length]
        at += length


def _uncompressed(chunk: Chunk) -> bytes:
    """The records of a chunk, of the size that it states: no more is ever unpacked."""
    stated, data = chunk.uncompressed_size, chunk.data
    if stated > _MAX_CHUNK_BYTES:
        raise McapError(f"chunk states {stated} bytes uncompressed, expected at most {_MAX_CHUNK_BYTES}")
    if chunk.compression == "zstd":
        framed = zstandard.frame_content_size(data)  # what is allocated, whatever limit is given; -1 where not stated
        if framed not in (-1, stated):
            raise McapError(f"chunk states {stated} bytes uncompressed, its zstd frame {framed}")
        data = zstandard.decompress(data, max_output_size=stated) if stated else b""
    elif chunk.compression == "lz4":
        data = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=stated + 1)
    elif chunk.compression:
        raise McapError(f"chunk is compressed by {chunk.compression[:20]!r}, expected zstd or lz4")
    if len(data) != stated:
        raise McapError(f"chunk states {stated} bytes uncompressed, expected what comes out: {len(data)} at least")
    if chunk.uncompressed_crc not in (0, checksum := zlib.crc32(data)):
        raise McapError(f"chunk has checksum {checksum}, expected {chunk.uncompressed_crc}")
    return data


def _parsed(kind: type[Record], content: bytes | memoryview) -> Record:
    """A record from its content: lengths within it cannot reach beyond."""
    return kind.read(ReadDataStream(BytesIO(content)))  # pyright: ignore[reportAttributeAccessIssue]


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


def _check_summary(file: Path, stream: IO[bytes]) -> int:
    """Where the index begins, 0 where there is none; its checksum is compared, where it has one."""
    footer_size = 9 + 20 + len(_MAGIC)  # opcode and length, three numbers, magic
    start = stream.seek(-footer_size, os.SEEK_END)
    summary_start, _, checksum = struct.unpack("<9xQQI8x", stream.read(footer_size))
    begin = summary_start or start
    stream.seek(min(begin, start))
    matches = checksum in (0, zlib.crc32(stream.read(max(0, start + 25 - begin))))  # 0: written without one
    if begin > start or not matches:
        raise SequenceError(f"{file}: damaged MCAP: index from byte {begin} on does not match its checksum")
    return summary_start
