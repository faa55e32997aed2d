"""One file of a rosbag2 of SQLite storage, as ROS 2 Humble records by default."""

from __future__ import annotations

import sqlite3
from collections import Counter
from collections.abc import Iterator, Set
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path

from sequences.errors import SequenceError
from sequences.recordings.recording_file import Channel, Piece, RawRecord, RecordingFile

MAGIC = b"SQLite format 3\0"
_ROWS = 1000  # of a piece


class SqliteFile(RecordingFile):
    """One SQLite file: opened, checked and listed. Its messages lie in it as they came, by their ids.

    It states no number of messages beside the messages themselves, which SQLite keeps whole or not at all.
    """

    def __init__(self, path: Path) -> None:
        """Open a file. Raises SequenceError where it is damaged, or no rosbag2."""
        super().__init__(path)
        self.states_counts = True
        with self._reading() as database:
            tables = {name for (name,) in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
            if not {"topics", "messages"} <= tables:
                raise SequenceError(f"{path}: SQLite without the tables `topics` and `messages`, expected a rosbag2")
            for id, *described in database.execute("SELECT id, name, type, serialization_format FROM topics"):
                name, kind, encoding = map(str, described)
                self.channels[id] = Channel(name, kind.replace("/msg/", "/"), encoding, b"")
            self.counts = self._counted(database, 0, 1 << 62, self.channels.keys())

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

    def _pieces(self, source: sqlite3.Connection) -> Iterator[Piece]:
        first, last = source.execute("SELECT min(id), max(id) FROM messages").fetchone()
        while first is not None:
            rows = source.execute("SELECT id FROM messages WHERE id >= ? ORDER BY id LIMIT 1 OFFSET ?", (first, _ROWS))
            end = (rows.fetchone() or (last + 1,))[0]
            counts = self._counted(source, first, end, self.channels.keys())
            yield Piece(
                counts.keys(),
                lambda ids, counts=counts: Counter({id: counts[id] for id in ids}),
                partial(self._records, source, first, end),
            )
            first = end if end <= last else None

    def _counted(self, database: sqlite3.Connection, first: int, end: int, ids: Set[int]) -> Counter[int]:
        """How many messages with ids from `first` up to `end` some channels have."""
        rows = database.execute(
            "SELECT topic_id, count(*) FROM messages WHERE id >= ? AND id < ? GROUP BY topic_id", (first, end)
        )
        return Counter({id: count for id, count in rows if id in ids})

    def _records(self, database: sqlite3.Connection, first: int, end: int, ids: Set[int]) -> Iterator[RawRecord]:
        wanted = ",".join(str(int(id)) for id in sorted(ids))
        rows = database.execute(
            f"SELECT topic_id, timestamp, data FROM messages WHERE id >= ? AND id < ? AND topic_id IN ({wanted})"
            " ORDER BY id",
            (first, end),
        )
        for id, log_time_ns, data in rows:
            if not (isinstance(log_time_ns, int) and isinstance(data, bytes)):
                raise ValueError(f"a message of {self.channels[id].topic} has no time or no bytes")
            yield RawRecord(id, log_time_ns, data)
