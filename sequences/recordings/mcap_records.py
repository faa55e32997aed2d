"""The records of an MCAP file, and those within its chunks.

Sizes that a file states are checked against it and against limits before memory is given to them; checksums are
compared where there are any.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import IO, TypeVar

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Chunk, McapRecord

from sequences.errors import SequenceError

_MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQ")  # of a record: opcode, length
_MAX_CHUNK_BYTES = 1 << 28  # of one chunk, uncompressed
_PIECE = 1 << 20
Record = TypeVar("Record", bound=McapRecord)


def read_with_chunks_opened(stream: IO[bytes]) -> Iterator[tuple[int, bytes | memoryview]]:
    """Records of a file from its beginning on, with those within chunks in their place."""
    for opcode, content in read_records(stream):
        if opcode == Opcode.CHUNK:
            yield from records_within(unpack_chunk(content))
        else:
            yield opcode, content


def read_records(stream: IO[bytes]) -> Iterator[tuple[int, bytes]]:
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


def read_record_at(stream: IO[bytes], offset: int, opcode: int) -> bytes:
    """Content of the record of some kind at some place."""
    stream.seek(offset)
    found, content = next(read_records(stream)) if offset else (None, b"")
    if found != opcode:
        raise McapError(f"no record of kind {opcode} at byte {offset}, where the index has one")
    return content


def unpack_chunk(content: bytes) -> bytes:
    """The records within a chunk."""
    return _uncompressed(parse_record(Chunk, content))


def records_within(chunk: bytes) -> Iterator[tuple[int, memoryview]]:
    """Opcode and content of each record within a chunk."""
    data, at = memoryview(chunk), 0
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


def parse_record(kind: type[Record], content: bytes | memoryview) -> Record:
    """A record from its content: lengths within it cannot reach beyond."""
    return kind.read(ReadDataStream(BytesIO(content)))  # pyright: ignore[reportAttributeAccessIssue]


def check_ends(file: Path) -> None:
    """Both magics of an MCAP file: the second is missing where a recording was cut off."""
    with open(file, "rb") as stream:
        head = stream.read(16)
        size = stream.seek(0, os.SEEK_END)
        stream.seek(max(0, size - len(_MAGIC)))
        tail = stream.read()
    if not head.startswith(_MAGIC):
        raise SequenceError(
            f"{file}: starts with {head[:8]!r}, expected the MCAP magic {_MAGIC!r}, SQLite or a ROS 1 bag"
        )
    if tail != _MAGIC or size < 2 * len(_MAGIC):
        raise SequenceError(
            f"{file}: truncated: byte {size - len(_MAGIC)} of {size} is {tail!r}, expected the closing MCAP magic"
            f" (`mcap recover` rescues what is readable)"
        )


def check_summary(file: Path, stream: IO[bytes]) -> int:
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
