"""One MCAP file. Records are parsed by the library's classes.

Sizes that a file states are checked against it and against limits before memory is given to them; checksums are
compared where there are any.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Set
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import IO, TypeVar

import lz4.frame
import zstandard
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Chunk, ChunkIndex, McapRecord, MessageIndex, Metadata, MetadataIndex, Schema, Statistics

from sequences.errors import SequenceError
from sequences.recordings.recording_file import Channel, RawRecord, RecordingFile

_MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQ")  # of a record: opcode, length
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time; data follow
_MAX_CHUNK_BYTES = 1 << 28  # of one chunk, uncompressed
_MAX_KEPT_BYTES = 1 << 26
_PIECE = 1 << 20
_Record = TypeVar("_Record", bound=McapRecord)


class LatestChunks:
    """The latest unpacked chunks of all files of a recording, at most 64 MB: several iterators need the same ones."""

    def __init__(self) -> None:
        self._kept: dict[tuple[Path, int], bytes] = {}  # the one used last comes last

    def get(self, file: Path, offset: int, unpack: Callable[[], bytes]) -> bytes:
        """The chunk that begins at some byte of a file, unpacked."""
        key = file, offset
        data = self._kept.pop(key, None)
        if data is None:
            data = unpack()
            if len(data) > _MAX_KEPT_BYTES:
                return data
        self._kept[key] = data
        while sum(map(len, self._kept.values())) > _MAX_KEPT_BYTES:
            del self._kept[next(iter(self._kept))]
        return data


class McapFile(RecordingFile):
    """One MCAP file. Without a usable index it is read once more to list its channels, and has no metadata."""

    rescue = "`mcap recover` rescues what is readable"

    def __init__(self, path: Path, chunks: LatestChunks) -> None:
        super().__init__(path)
        self._schemas: dict[int, Schema] = {}
        self._listed: dict[int, records.Channel] = {}
        self._chunks: list[ChunkIndex] = []
        self._latest = chunks
        _check_ends(path)
        with self._reading() as stream:
            summary_start = _check_summary(path, stream)
            statistics = self._read_summary(stream, summary_start) if summary_start else None
            self._chunks.sort(key=lambda c: c.chunk_start_offset)
            # Reading by the index needs all channels, and which of them each chunk has.
            self._indexed = bool(statistics and self._chunks) and (
                all(
                    c.message_index_offsets and c.message_index_offsets.keys() <= self._listed.keys()
                    for c in self._chunks
                )
                and len({c.chunk_start_offset for c in self._chunks}) == len(self._chunks)
            )
            if statistics and statistics.channel_message_counts:
                self.counts, self.states_counts = Counter(statistics.channel_message_counts), True
            if not (self._indexed and self.states_counts):
                counted = self._list_by_reading(stream)
                self.counts = self.counts or counted
        self.channels = {id: self._described(channel) for id, channel in self._listed.items()}

    @contextmanager
    def _reading(self) -> Iterator[IO[bytes]]:
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
        """Take in schemas, channels, metadata and indexes of chunks; returns the statistics, if there are any."""
        statistics = None
        stream.seek(start)
        places: list[int] = []
        for opcode, content in _read_records(stream):
            if opcode == Opcode.CHUNK_INDEX:
                self._chunks.append(_parse_record(ChunkIndex, content))
            elif opcode == Opcode.METADATA_INDEX:
                places.append(_parse_record(MetadataIndex, content).offset)
            elif opcode == Opcode.STATISTICS:
                statistics = _parse_record(Statistics, content)
            else:
                self._list(opcode, content)
        for place in places:
            record = _parse_record(Metadata, _read_record_at(stream, place, Opcode.METADATA))
            self.metadata[record.name] = record.metadata
        return statistics

    def _list(self, opcode: int, content: bytes | memoryview) -> None:
        if opcode == Opcode.SCHEMA:
            schema = _parse_record(Schema, content)
            self._schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = _parse_record(records.Channel, content)
            self._listed[channel.id] = channel

    def _described(self, channel: records.Channel) -> Channel:
        schema = self._schemas.get(channel.schema_id)
        name, definition = (schema.name.replace("/msg/", "/"), schema.data) if schema is not None else ("", b"")
        return Channel(channel.topic, name, channel.message_encoding, definition)

    def _list_by_reading(self, stream: IO[bytes]) -> Counter[int]:
        found: Counter[int] = Counter()
        stream.seek(0)
        for opcode, content in _read_with_chunks_opened(stream):
            if opcode == Opcode.MESSAGE:
                found[_MESSAGE.unpack_from(content)[0]] += 1
            else:
                self._list(opcode, content)
        return found

    def _records(self, asked: Set[int], wanted: Set[int], found: Counter[int]) -> Iterator[RawRecord]:
        with self._reading() as stream:
            if not self._indexed:
                yield from self._of(asked, _read_with_chunks_opened(stream))
                return
            for index in self._chunks:
                ids = index.message_index_offsets.keys()
                if ids.isdisjoint(wanted):
                    found.update(self._counted_beside(stream, index, asked & ids))
                else:
                    yield from self._of_chunk(stream, index, asked)

    def _counted_beside(self, stream: IO[bytes], chunk: ChunkIndex, ids: Set[int]) -> Counter[int]:
        counts: Counter[int] = Counter()
        for id in ids:
            index = _parse_record(
                MessageIndex, _read_record_at(stream, chunk.message_index_offsets[id], Opcode.MESSAGE_INDEX)
            )
            counts[index.channel_id] += len(index.records)
        return counts

    def _of_chunk(self, stream: IO[bytes], index: ChunkIndex, ids: Set[int]) -> Iterator[RawRecord]:
        at = index.chunk_start_offset
        data = self._latest.get(self.path, at, lambda: unpack_chunk(_read_record_at(stream, at, Opcode.CHUNK)))
        return self._of(ids, _records_within(data))

    def _of(self, ids: Set[int], found: Iterator[tuple[int, bytes | memoryview]]) -> Iterator[RawRecord]:
        for opcode, content in found:
            if opcode == Opcode.MESSAGE:
                channel_id, _, log_time_ns, _ = _MESSAGE.unpack_from(content)
                if channel_id in ids:
                    yield RawRecord(channel_id, log_time_ns, bytes(content[_MESSAGE.size :]))
                elif channel_id not in self.channels:
                    raise McapError(f"a message of channel {channel_id}, which is not listed")


def _read_with_chunks_opened(stream: IO[bytes]) -> Iterator[tuple[int, bytes | memoryview]]:
    """Records of a file from its beginning on, with chunks replaced by the records within them."""
    for opcode, content in _read_records(stream):
        if opcode == Opcode.CHUNK:
            yield from _records_within(unpack_chunk(content))
        else:
            yield opcode, content


def _read_records(stream: IO[bytes]) -> Iterator[tuple[int, bytes]]:
    """Opcode and content of each record from the stream's position to the footer, without attachments.

    A checksum of the data section is compared where reading starts at the beginning of the file.
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
        if opcode == Opcode.ATTACHMENT:  # of any size, and never needed
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


def _read_record_at(stream: IO[bytes], offset: int, opcode: int) -> bytes:
    stream.seek(offset)
    found, content = next(_read_records(stream)) if offset else (None, b"")
    if found != opcode:
        raise McapError(f"no record of kind {opcode} at byte {offset}, where the index has one")
    return content


def _records_within(chunk: bytes) -> Iterator[tuple[int, memoryview]]:
    data, at = memoryview(chunk), 0
    while at < len(data):
        opcode, length = _HEAD.unpack_from(data, at)
        at += _HEAD.size
        if length > len(data) - at:
            raise McapError(f"record of {length} bytes, which is beyond the end of its chunk")
        yield opcode, data[at : at + length]
        at += length


def unpack_chunk(content: bytes) -> bytes:
    """The records of a chunk; never more than the size that it states is unpacked."""
    chunk = _parse_record(Chunk, content)
    stated, data = chunk.uncompressed_size, chunk.data
    if stated > _MAX_CHUNK_BYTES:
        raise McapError(f"chunk states {stated} bytes uncompressed, expected at most {_MAX_CHUNK_BYTES}")
    if chunk.compression == "zstd":
        framed = zstandard.frame_content_size(data)  # allocated whatever the limit; -1 where not stated
        if framed not in (-1, stated):
            raise McapError(f"chunk states {stated} bytes uncompressed, its zstd frame {framed}")
        data = zstandard.decompress(data, max_output_size=stated) if stated else b""
    elif chunk.compression == "lz4":
        data = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=stated + 1)
    elif chunk.compression:
        raise McapError(f"chunk is compressed by {chunk.compression[:20]!r}, expected zstd or lz4")
    if len(data) != stated:
        raise McapError(f"chunk states {stated} bytes uncompressed, expected {len(data)} at least, as they came out")
    if chunk.uncompressed_crc not in (0, checksum := zlib.crc32(data)):
        raise McapError(f"chunk has checksum {checksum}, expected {chunk.uncompressed_crc}")
    return data


def _parse_record(kind: type[_Record], content: bytes | memoryview) -> _Record:
    return kind.read(ReadDataStream(BytesIO(content)))  # pyright: ignore[reportAttributeAccessIssue]


def _check_ends(file: Path) -> None:
    """Check both magics of a file: the second is missing where a recording was cut off."""
    with open(file, "rb") as stream:
        head = stream.read(16)
        size = stream.seek(0, os.SEEK_END)
        stream.seek(max(0, size - len(_MAGIC)))
        tail = stream.read()
    if not head:
        raise SequenceError(f"{file}: is empty, expected an MCAP file, SQLite or a ROS 1 bag")
    if not head.startswith(_MAGIC):
        raise SequenceError(
            f"{file}: starts with {head[:8]!r}, expected the MCAP magic {_MAGIC!r}, SQLite or a ROS 1 bag"
        )
    if tail != _MAGIC or size < 2 * len(_MAGIC):
        raise SequenceError(
            f"{file}: truncated: byte {size - len(_MAGIC)} of {size} is {tail!r}, expected the closing MCAP magic"
            f" (`mcap recover` rescues what is readable)"
        )


def _check_summary(file: Path, stream: IO[bytes]) -> int:
    """Where the index begins, 0 where there is none; its checksum is compared."""
    footer_size = 9 + 20 + len(_MAGIC)  # opcode and length, three numbers, magic
    start = stream.seek(-footer_size, os.SEEK_END)
    summary_start, _, checksum = struct.unpack("<9xQQI8x", stream.read(footer_size))
    begin = summary_start or start
    stream.seek(min(begin, start))
    matches = checksum in (0, zlib.crc32(stream.read(max(0, start + 25 - begin))))  # 0: written without one
    if begin > start or not matches:
        raise SequenceError(f"{file}: damaged MCAP: index from byte {begin} on does not match its checksum")
    return summary_start
