"""One MCAP file: its channels, and a stream of raw messages in bounded memory.

The classes of the library say what a record holds. Reading is ours: the messages that come are counted against those
that the file states.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Set
from contextlib import contextmanager
from pathlib import Path
from typing import IO, NamedTuple

from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, MessageIndex, Metadata, MetadataIndex, Schema, Statistics

from sequences.errors import SequenceError
from sequences.recordings.mcap_records import (
    check_ends,
    check_summary,
    open_chunk,
    parse_record,
    read_record_at,
    read_records,
    read_with_chunks_opened,
)

_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time; data follow
_MAX_HELD_BYTES = 1 << 29  # of messages of chunks that overlap in time
_MESSAGE_COSTS = 300  # bytes that a held message takes beside its data


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
        check_ends(path)
        with self._reading() as stream:
            summary_start = check_summary(path, stream)
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
            self.schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = parse_record(Channel, content)
            self.channels[channel.id] = channel

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

    def _chunks_of(self, asked: Set[int]) -> list[ChunkIndex]:
        """The chunks that have some of the channels asked for, the earliest last."""
        chunks = [c for c in self._chunks if not c.message_index_offsets.keys().isdisjoint(asked)]
        return sorted(chunks, key=lambda c: (c.message_start_time, c.chunk_start_offset), reverse=True)

    def _counted_beside(self, stream: IO[bytes], chunk: ChunkIndex, asked: Set[int]) -> Counter[int]:
        """How many messages of the channels asked for a chunk has, by the indexes that lie beside it."""
        counts: Counter[int] = Counter()
        for id in asked & chunk.message_index_offsets.keys():
            index = parse_record(
                MessageIndex, read_record_at(stream, chunk.message_index_offsets[id], Opcode.MESSAGE_INDEX)
            )
            counts[index.channel_id] += len(index.records)
        return counts

    def _by_log_time(
        self, stream: IO[bytes], asked: Set[int], unopened: list[ChunkIndex], found: Counter[int]
    ) -> Iterator[RawRecord]:
        """Messages of chunks, which are taken from the end of a list, opened and counted when their time has come."""
        held: list[tuple[int, int, int, RawRecord]] = []  # the earliest last
        num_bytes = 0

        def ready(until_ns: int) -> Iterator[RawRecord]:
            nonlocal num_bytes
            while held and held[-1][0] < until_ns:
                record = held.pop()[-1]
                num_bytes -= len(record.data) + _MESSAGE_COSTS
                yield record

        while unopened:
            yield from ready(unopened[-1].message_start_time)
            index = unopened.pop()
            chunk = read_record_at(stream, index.chunk_start_offset, Opcode.CHUNK)
            for number, (opcode, content) in enumerate(open_chunk(chunk)):
                if opcode == Opcode.MESSAGE and (record := self._asked_for(content, asked, found)) is not None:
                    held.append((record.log_time_ns, index.chunk_start_offset, number, record))
                    num_bytes += len(record.data) + _MESSAGE_COSTS
                    if num_bytes > _MAX_HELD_BYTES:
                        raise McapError(f"chunks overlap in time by more than {_MAX_HELD_BYTES} bytes of messages")
            held.sort(reverse=True)
        yield from ready(1 << 64)  # no log time is later

    def _as_written(self, stream: IO[bytes], asked: Set[int], found: Counter[int]) -> Iterator[RawRecord]:
        for opcode, content in read_with_chunks_opened(stream):
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
