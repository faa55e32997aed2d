"""One file of a recording, of whatever format: its channels, and a stream of raw messages in bounded memory.

A file consists of pieces, which are read in the order in which they lie in it: chunks, stretches of rows, or all of it.
What an index says of a piece that nobody needs is believed without opening it; what comes is counted, and compared with
what the file states.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Set
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

from sequences.errors import SequenceError

SUFFIXES = (".mcap", ".db3", ".bag")
"""Of the names of recordings' files."""

_MAX_KEPT_BYTES = 1 << 26


class Channel(NamedTuple):
    """What a file says of the messages of one writer: their topic, type, encoding and the type's definition."""

    topic: str
    type: str
    encoding: str
    definition: bytes


class RawRecord(NamedTuple):
    """One message as it lies in a file: the channel's id, the time it was logged and its bytes."""

    channel_id: int
    log_time_ns: int
    data: bytes


class Piece(NamedTuple):
    """A part of a file.

    Attributes:
        channels: Which channels it has messages of; None where only reading tells.
        counted: Gives how many messages of some channels it has, without reading them.
        records: Gives the messages of some channels.
    """

    channels: Set[int] | None
    counted: Callable[[Set[int]], Counter[int]]
    records: Callable[[Set[int]], Iterator[RawRecord]]


class RecordingFile(ABC):
    """One file: opened, checked and listed.

    Attributes:
        path: What was opened.
        channels: Channels by id.
        counts: How many messages each channel has, by id: as the file states it, where it does, else as counted.
        states_counts: Whether the file itself states how many messages it has.
        metadata: Metadata records by name, later ones over earlier ones.
    """

    rescue: ClassVar[str] = "record it anew"
    """What may help where messages are missing."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.channels: dict[int, Channel] = {}
        self.counts: Counter[int] = Counter()
        self.states_counts = False
        self.metadata: dict[str, dict[str, str]] = {}

    def messages(
        self, topics: Collection[str], *, until: Callable[[int], bool] = lambda log_time_ns: False
    ) -> Iterator[RawRecord]:
        """Messages of some topics, in the order in which they lie in the file; several iterators may run at once.

        Args:
            topics: Names of topics.
            until: Whether messages of a channel from a log time on are not wanted: those that lie behind the first such
                one are not given, but counted, without opening the pieces that hold nothing else.

        Raises:
            SequenceError: the file is damaged; at the end, where there are fewer or more messages than it states.
        """
        asked = {id for id, channel in self.channels.items() if channel.topic in topics}
        found: Counter[int] = Counter()
        wanted = set(asked)
        with self._reading() as source:
            for piece in self._pieces(source):
                if piece.channels is not None and piece.channels.isdisjoint(wanted):
                    found += piece.counted(asked & piece.channels)
                    continue
                for record in piece.records(asked):
                    id = record.channel_id
                    found[id] += 1
                    if id not in wanted:
                        continue
                    if until(record.log_time_ns):
                        wanted.discard(id)
                        continue
                    yield record
        for id in sorted(asked):
            if found[id] != self.counts[id]:
                raise SequenceError(
                    f"{self.path}: {self.channels[id].topic}: {found[id]} messages found where the file states"
                    f" {self.counts[id]}: it is damaged; expected all of them ({self.rescue})"
                )

    @abstractmethod
    def _reading(self) -> AbstractContextManager[Any]:
        """Open the file; whatever goes wrong while reading becomes an error that names it and says what was found."""

    @abstractmethod
    def _pieces(self, source: Any) -> Iterator[Piece]:
        """The pieces of the file, in their order, as `_reading` has opened it."""


class LatestChunks:
    """The chunks that were unpacked last, of all files of a recording: several iterators close by need the same ones.

    Chunks of 64 MB together are kept at most.
    """

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
