"""Recordings of ROS and Foxglove: their topics, and a stream of raw messages in bounded memory."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from filtering.errors import counted, listed, quoted
from sequences.errors import SequenceError
from sequences.files import read_yaml, require_inside, unused_part
from sequences.recordings.mcap_file import LatestChunks, McapFile
from sequences.recordings.recording_file import (
    ROS1_MAGIC,
    SQLITE_MAGIC,
    Channel,
    RecordingFile,
    Ros1File,
    SqliteFile,
)
from sequences.recordings.serializations import encoding_of, plain
from sequences.recordings.source import TF, RawMessage, Stamps, Topic, fixed_links_of, namespaced_tf, stands_for
from sequences.values import parse_whole

METADATA_NAME = "vapor-track"
"""Name of the metadata record that states the origin of a file's images and odometry."""
_MOST_MESSAGES = 10**18
_SUFFIXES = (".mcap", ".db3")
_PACKED = ".zstd"


class Bag:
    """One recording: an MCAP file, a ROS 1 bag, or a rosbag2 of MCAP or SQLite files: opened, checked and listed.

    Attributes:
        metadata: Metadata records by name, later ones over earlier ones; empty for files without an index.
    """

    def __init__(self, path: Path, *, stamps: Stamps = "header", tf_topic: str | None = TF):
        """Open a file or folder; headers keep their stamps or get log times; for `tf_topic` see `namespaced_tf`.

        Raises SequenceError where a file is missing, truncated or of another format, or metadata.yaml is damaged.
        """
        self.path = Path(path)
        self._restamped = stamps == "log"
        self.topics: dict[str, Topic] = {}
        self.metadata: dict[str, dict[str, str]] = {}
        self._fixed_links: frozenset[tuple[str, str]] | None = None
        self._listing = None if self.path.is_file() else _read_listing(self.path)
        self._latest = LatestChunks()
        self._files = [self._opened(file) for file in (self._listing.files if self._listing else [self.path])]
        for file in self._files:
            self.metadata |= file.metadata
            for id, channel in file.channels.items():
                known = self.topics.get(channel.topic)
                count = file.counts[id] + (known.num_messages if known else 0)
                topic = Topic(channel.topic, channel.type, count, encoding_of(channel.type, channel.encoding))
                if not topic.is_misnamed:
                    self.topics[topic.name] = topic
        self._tf = namespaced_tf(self.topics, tf_topic, self.path)

    def _opened(self, file: Path) -> RecordingFile:
        with open(file, "rb") as stream:
            head = stream.read(16)
        if head.startswith(SQLITE_MAGIC):
            return SqliteFile(file)
        if head.startswith(ROS1_MAGIC):
            return Ros1File(file)
        return McapFile(file, self._latest)

    def __contains__(self, topic: str) -> bool:
        return any(topic in stands_for(known, self._tf) for known in self.topics.values())

    def account_for(self, topic: str) -> list[str]:
        """Compare the number of messages of a topic, or of all where it is not listed, with that of metadata.yaml.

        Returns notices of files whose lost messages go unnoticed, as nothing states their number, or that are not read.
        Raises SequenceError where there are more or fewer.
        """
        uncounted = [
            f"{file.path.name} states no number of messages: lost images go unnoticed"
            for file in self._files
            if not file.states_counts
        ]
        listing = self._listing
        if listing is None:
            return uncounted
        if topic in listing.of_topics:
            what, stated, found = quoted(topic), listing.of_topics[topic], self.topics[topic].num_messages
        else:
            what, stated = "all topics", listing.num_messages
            found = sum(file.counts.total() for file in self._files)
        if stated is None:
            lost = "metadata.yaml states no number of messages: images in lost files go unnoticed"
            return [lost, *uncounted, *listing.notices]
        if stated != found:
            beside = f"; beside them lies {listing.unlisted_names}" if listing.unlisted else ""
            raise SequenceError(
                f"{listing.path}: {what}: the files that it lists have {counted(found, 'message')}, expected"
                f" the {stated} that it states{beside} (`ros2 bag reindex` writes it again)"
            )
        return listing.notices

    def messages(
        self, topics: Collection[str], *, until: Callable[[int], bool] = lambda log_time_ns: False
    ) -> Iterator[RawMessage]:
        """Messages of some topics, file after file, see `RecordingFile.messages`; each topic must have one type.

        Foxglove's transforms come once as /tf_static and once as /tf, where both are asked for.
        """
        asked = {t.name: [name for name in stands_for(t, self._tf) if name in topics] for t in self.topics.values()}
        names = [name for name, stands_for in asked.items() if stands_for]
        for file in self._files:
            known: set[int] = set()
            for record in file.messages(names, until=until):
                channel = file.channels[record.channel_id]
                if record.channel_id not in known:
                    self._require_one_type(file, channel)
                    known.add(record.channel_id)
                kind, encoding, definition = channel[1:]
                data, problem = record.data, ""
                try:
                    data = plain(kind, encoding, data)
                except Exception as error:  # the libraries let struct, index and assertion errors through
                    problem = f"{type(error).__name__}: {error}"
                encoding = encoding_of(kind, encoding)
                for name in asked[channel.topic]:
                    yield RawMessage(
                        name, record.log_time_ns, data, kind, encoding, definition, self._restamped, problem
                    )

    def _require_one_type(self, file: RecordingFile, channel: Channel) -> None:
        """Raise SequenceError where the topic of a channel has another type or encoding elsewhere."""
        topic = self.topics[channel.topic]
        encoding = encoding_of(channel.type, channel.encoding)
        if (channel.type, encoding) != (topic.type, topic.encoding):
            raise SequenceError(
                f"{file.path}: {quoted(topic.name)} has messages of {quoted(channel.type)}"
                f" ({quoted(encoding)}) and of {quoted(topic.type)} ({quoted(topic.encoding)}),"
                " expected one type a topic"
            )

    def fixed_links(self) -> frozenset[tuple[str, str]]:
        """See `fixed_links_of`."""
        if self._fixed_links is None:
            self._fixed_links = fixed_links_of(self)
        return self._fixed_links


def bag_files(path: Path) -> list[Path]:
    """The files of a recording, in their order. Raises SequenceError as `Bag` does."""
    return [path] if path.is_file() else _read_listing(path).files


@dataclass(frozen=True)
class _Listing:
    """The metadata.yaml of a rosbag2 folder: its files, and how many messages all and single topics have.

    Attributes:
        unlisted: Names of such files beside it that it does not list.
        num_messages: None where it states none, as after a crash.
        of_topics: By name; empty where it states none.
    """

    path: Path
    files: list[Path]
    unlisted: list[str]
    num_messages: int | None
    of_topics: Counter[str]

    @property
    def notices(self) -> list[str]:
        """Sentences for users."""
        return [f"metadata.yaml does not list {self.unlisted_names}: not read"] if self.unlisted else []

    @property
    def unlisted_names(self) -> str:
        """The first three of the unlisted files, and the number of others."""
        return listed(map(quoted, self.unlisted), 3)


def _read_listing(folder: Path) -> _Listing:
    """Read the metadata.yaml of a rosbag2 folder.

    Its counts of single files are ignored: recorders count messages there that their cache then drops, and `ros2 bag
    convert` counted messages twice.

    Raises:
        SequenceError: it is missing or no YAML, a number in it is none, or it lists no file, a missing one, one of
            unknown format or outside the folder, or one in `files` alone.
    """
    if not folder.is_dir():
        raise SequenceError(
            f"{folder}: no such file or folder, expected an .mcap file, a rosbag2 folder or a ROS 1 bag"
            f"{unused_part(folder)}"
        )
    path = folder / "metadata.yaml"
    if not path.is_file():
        if _bag_files(folder):
            helps = ", or its files one by one (`ros2 bag reindex` writes one)"
        else:
            made = Path(f"{folder if folder.name else folder.absolute()}.mcap")
            words = shlex.join(["vapor-track", "convert", str(folder), str(made)])
            helps = f"; `{words}` makes one of a data set"
        raise SequenceError(f"{folder}: folder has no metadata.yaml, expected an .mcap file or a rosbag2 folder{helps}")
    content = read_yaml(path)
    content = content.get("rosbag2_bagfile_information", content)
    names = list(dict.fromkeys(str(name) for name in _list(content, "relative_file_paths", path)))
    if not names:
        raise SequenceError(f"{path}: names no files, expected `relative_file_paths:` with one or more files")
    beside = {file.name for file in _bag_files(folder)}
    names = [name.removesuffix(_PACKED) if name.removesuffix(_PACKED) in beside else name for name in names]
    for name in names:
        if name.endswith(_PACKED):
            raise SequenceError(f"{path}: names {quoted(name)}, a file packed as a whole; unpack it first: `zstd -d`")
        if not name.endswith(_SUFFIXES):
            raise SequenceError(f"{path}: names {quoted(name)}, expected .mcap or .db3 files")
    listed = {Path(name).name for name in names}
    for item in _list(content, "files", path):
        name = Path(str(item.get("path", ""))).name if isinstance(item, dict) else ""
        name = name.removesuffix(_PACKED) if name.removesuffix(_PACKED) in listed else name
        if name.endswith(_SUFFIXES) and name not in listed:
            raise SequenceError(
                f"{path}: `files` has {quoted(name)} and `relative_file_paths` has not, expected it in both"
            )
    files = [folder / name for name in names]
    require_inside(folder, files)
    for file, name in zip(files, names, strict=True):
        if not file.is_file():
            raise SequenceError(f"{path}: names {quoted(name)}, which is not in the folder")
    read = {file.resolve() for file in files}
    unlisted = [file.name for file in _bag_files(folder) if file.resolve() not in read]
    of_topics: Counter[str] = Counter()
    for item in _list(content, "topics_with_message_count", path):
        topic = item.get("topic_metadata") if isinstance(item, dict) else None
        if isinstance(topic, dict) and "name" in topic and (count := _count(item, path)) is not None:
            of_topics[str(topic["name"])] += count
    return _Listing(path, files, unlisted, _count(content, path) or None, of_topics if of_topics.total() else Counter())


def _bag_files(folder: Path) -> list[Path]:
    return sorted(file for file in folder.iterdir() if file.suffix in _SUFFIXES and file.is_file())


def _list(content: Any, name: str, path: Path) -> list[Any]:
    value = content.get(name) if isinstance(content, dict) else None
    if not isinstance(value, list | None):
        raise SequenceError(f"{path}: `{name}` is {quoted(value)}, expected a list")
    return value or []


def _count(content: Any, path: Path) -> int | None:
    value = content.get("message_count") if isinstance(content, dict) else None
    return None if value is None else parse_whole(str(value), f"{path}: message_count", 0, _MOST_MESSAGES)
