"""Recordings of ROS and Foxglove: their topics, and a stream of raw messages in bounded memory."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from pathlib import Path

from filtering.errors import quoted
from sequences.errors import SequenceError
from sequences.recordings import ros1_file, sqlite_file
from sequences.recordings.mcap_file import McapFile
from sequences.recordings.recording_file import Channel, LatestChunks, RecordingFile
from sequences.recordings.ros1_file import Ros1File
from sequences.recordings.rosbag2 import read_listing
from sequences.recordings.serializations import encoding_of, plain
from sequences.recordings.source import TF, RawMessage, Stamps, Topic, fixed_links_of, namespaced_tf, stands_for
from sequences.recordings.sqlite_file import SqliteFile

METADATA_NAME = "vapor-track"
"""Of the metadata record in which a file says where its odometry comes from."""


class Bag:
    """One recording: an MCAP file, a ROS 1 bag, or a rosbag2 of MCAP or SQLite files: opened, checked and listed.

    Attributes:
        path: What was opened.
        topics: Topics by name; without those that are misnamed, which nobody could ask for.
        metadata: Metadata records by name, later ones over earlier ones; empty for files without an index.
    """

    def __init__(self, path: Path, *, stamps: Stamps = "header", tf_topic: str | None = TF):
        """Open a bag.

        Args:
            path: File or folder.
            stamps: Whether messages keep the stamps of their headers, or get the times at which they were logged.
            tf_topic: Which topic is tf, see `namespaced_tf`.

        Raises:
            SequenceError: a file is missing, truncated, garbage or of another format, or metadata.yaml is damaged.
        """
        self.path = Path(path)
        self._restamped = stamps == "log"
        self.topics: dict[str, Topic] = {}
        self.metadata: dict[str, dict[str, str]] = {}
        self._fixed_links: frozenset[tuple[str, str]] | None = None
        self._listing = None if self.path.is_file() else read_listing(self.path)
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
        if head.startswith(sqlite_file.MAGIC):
            return SqliteFile(file)
        if head.startswith(ros1_file.MAGIC):
            return Ros1File(file)
        return McapFile(file, self._latest)

    @property
    def is_running(self) -> bool:
        """It does not go on."""
        return False

    def __contains__(self, topic: str) -> bool:
        """Whether messages of a topic can be asked for."""
        return any(topic in stands_for(known, self._tf) for known in self.topics.values())

    def account_for(self, topic: str) -> list[str]:
        """Compare how many messages of a topic there are with how many metadata.yaml states.

        Where it does not name the topic, those of all topics are compared. Files are compared with what they state
        themselves as they are read.

        Returns:
            What a person should know: where lost messages cannot be told, as nothing states how many there were, and
            which files are not read.

        Raises:
            SequenceError: there are more or fewer.
        """
        uncounted = [
            f"{file.path.name} states no number of messages: images that it lost cannot be told"
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
            lost = "metadata.yaml states no number of messages: images of files that it lost cannot be told"
            return [lost, *uncounted, *listing.notices]
        if stated != found:
            beside = f"; beside them lies {listing.unlisted_said}" if listing.unlisted else ""
            raise SequenceError(
                f"{listing.path}: {what}: the files that it lists have {found} messages, expected the {stated} that it"
                f" states{beside} (`ros2 bag reindex` writes it anew)"
            )
        return listing.notices

    def messages(
        self, topics: Collection[str], *, until: Callable[[int], bool] = lambda log_time_ns: False
    ) -> Iterator[RawMessage]:
        """Messages of some topics in the order in which they lie in a file, file after file.

        Several iterators may run at once. Those of Foxglove's transforms come once as /tf_static and once as /tf, where
        both are asked for.

        Args:
            topics: Names of topics.
            until: Whether messages of a topic from a log time on are not wanted: of each file, those of its writer that
                lie behind the first such one are not given; they are counted all the same.

        Raises:
            SequenceError: a file is damaged, or at its end has other numbers of messages than it states, or a topic has
                messages of several types.
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
        """Raises SequenceError where the topic of a channel has another type or encoding elsewhere."""
        topic = self.topics[channel.topic]
        encoding = encoding_of(channel.type, channel.encoding)
        if (channel.type, encoding) != (topic.type, topic.encoding):
            raise SequenceError(
                f"{file.path}: {quoted(topic.name)} has messages of {quoted(channel.type)}"
                f" ({quoted(encoding)}) and of {quoted(topic.type)} ({quoted(topic.encoding)}),"
                " expected one type a topic"
            )

    def fixed_links(self) -> frozenset[tuple[str, str]]:
        """Of Foxglove's transforms, see `fixed_links_of`."""
        if self._fixed_links is None:
            self._fixed_links = fixed_links_of(self)
        return self._fixed_links


def bag_files(path: Path) -> list[Path]:
    """The files of a recording, in their order. Raises SequenceError as `Bag` does."""
    return [path] if path.is_file() else read_listing(path).files
