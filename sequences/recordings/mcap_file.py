"""One MCAP file. The classes of the library say what a record holds; reading is ours."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Iterator, Set
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import IO

from mcap import records
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import ChunkIndex, MessageIndex, Metadata, MetadataIndex, Schema, Statistics

from sequences.errors import SequenceError
from sequences.recordings.mcap_records import (
    check_ends,
    check_summary,
    parse_record,
    read_record_at,
    read_records,
    read_with_chunks_opened,
    records_within,
    unpack_chunk,
)
from sequences.recordings.recording_file import Channel, LatestChunks, Piece, RawRecord, RecordingFile

_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time; data follow


class McapFile(RecordingFile):
    """One MCAP file: opened, checked and listed.

    Files without a usable index (no summary section) are read from front to back once more to list their channels, and
    have no metadata.
    """

    rescue = "`mcap recover` rescues what is readable"

    def __init__(self, path: Path, chunks: LatestChunks) -> None:
        """Open a file. Raises SequenceError where it is truncated, garbage or of another format."""
        super().__init__(path)
        self._schemas: dict[int, Schema] = {}
        self._listed: dict[int, records.Channel] = {}
        self._chunks: list[ChunkIndex] = []
        self._latest = chunks
        check_ends(path)
        with self._reading() as stream:
            summary_start = check_summary(path, stream)
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
            stated = statistics.channel_message_counts if statistics and statistics.channel_message_counts else None
            self.counts = Counter(stated)
            if not self._indexed or stated is None:
                counted, by_indexes = self._list_by_reading(stream)
                self.counts = self.counts or by_indexes or counted
                stated = stated or by_indexes
            self.states_counts = bool(stated)
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
        """Take in schemas, channels, metadata and indexes of chunks; what the file states of its size, if it does."""
        statistics = None
        stream.seek(start)
        places: list[int] = []
        for opcode, content in read_records(stream):
            if opcode == Opcode.CHUNK_INDEX:
                self._chunks.append(parse_record(ChunkIndex, content))
            elif opcode == Opcode.METADATA_INDEX:
                places.append(parse_record(MetadataIndex, content).offset)
            elif opcode == Opcode.STATISTICS:
                statistics = parse_record(Statistics, content)
            else:
                self._list(opcode, content)
        for place in places:
            record = parse_record(Metadata, read_record_at(stream, place, Opcode.METADATA))
            self.metadata[record.name] = record.metadata
        return statistics

    def _list(self, opcode: int, content: bytes | memoryview) -> None:
        """Take in a schema or a channel."""
        if opcode == Opcode.SCHEMA:
            schema = parse_record(Schema, content)
            self._schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = parse_record(records.Channel, content)
            self._listed[channel.id] = channel

    def _described(self, channel: records.Channel) -> Channel:
        schema = self._schemas.get(channel.schema_id)
        name, definition = (schema.name.replace("/msg/", "/"), schema.data) if schema is not None else ("", b"")
        return Channel(channel.topic, name, channel.message_encoding, definition)

    def _list_by_reading(self, stream: IO[bytes]) -> tuple[Counter[int], Counter[int]]:
        """Read all for schemas and channels: how many messages came, and how many the indexes beside chunks state."""
        found: Counter[int] = Counter()
        stated: Counter[int] = Counter()
        stream.seek(0)
        for opcode, content in read_with_chunks_opened(stream):
            if opcode == Opcode.MESSAGE:
                found[_MESSAGE.unpack_from(content)[0]] += 1
            elif opcode == Opcode.MESSAGE_INDEX:
                index = parse_record(MessageIndex, content)
                stated[index.channel_id] += len(index.records)
            else:
                self._list(opcode, content)
        return found, stated

    def _pieces(self, source: IO[bytes]) -> Iterator[Piece]:
        if not self._indexed:
            yield Piece(None, lambda ids: Counter(), lambda ids: self._of(ids, read_with_chunks_opened(source)))
        for index in self._chunks if self._indexed else []:
            counted = partial(self._counted_beside, source, index)
            yield Piece(index.message_index_offsets.keys(), counted, partial(self._of_chunk, source, index))

    def _counted_beside(self, stream: IO[bytes], chunk: ChunkIndex, ids: Set[int]) -> Counter[int]:
        """How many messages of some of its channels a chunk has, by the indexes that lie beside it."""
        counts: Counter[int] = Counter()
        for id in ids:
            index = parse_record(
                MessageIndex, read_record_at(stream, chunk.message_index_offsets[id], Opcode.MESSAGE_INDEX)
            )
            counts[index.channel_id] += len(index.records)
        return counts

    def _of_chunk(self, stream: IO[bytes], index: ChunkIndex, ids: Set[int]) -> Iterator[RawRecord]:
        at = index.chunk_start_offset
        data = self._latest.get(self.path, at, lambda: unpack_chunk(read_record_at(stream, at, Opcode.CHUNK)))
        return self._of(ids, records_within(data))

    def _of(self, ids: Set[int], found: Iterator[tuple[int, bytes | memoryview]]) -> Iterator[RawRecord]:
        """The messages among records that are of some channels."""
        for opcode, content in found:
            if opcode == Opcode.MESSAGE:
                channel_id, _, log_time_ns, _ = _MESSAGE.unpack_from(content)
                if channel_id in ids:
                    yield RawRecord(channel_id, log_time_ns, bytes(content[_MESSAGE.size :]))
                elif channel_id not in self.channels:
                    raise McapError(f"a message of channel {channel_id}, which is not listed")
