"""What gives raw messages by topic: a recording, or what was heard of a running system so far."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Literal, NamedTuple, Protocol, runtime_checkable

from filtering.errors import quoted
from sequences.errors import NotFoundError, SequenceError
from sequences.recordings import foxglove, serializations
from sequences.recordings.messages import frame_name

Stamps = Literal["header", "log"]
TF_STATIC, TF = "/tf_static", "/tf"
_TRANSFORMS = ("tf2_msgs/TFMessage", "tf/tfMessage")


@dataclass(frozen=True)
class Topic:
    """One topic of a bag.

    Attributes:
        name: Name of the topic.
        type: Message type as the file names it, without `/msg`: `nav_msgs/Odometry`, `foxglove.PoseInFrame`.
        num_messages: How many messages it has, all files of the bag together.
        encoding: How messages are serialized; ROS 2 has "cdr".
    """

    name: str
    type: str
    num_messages: int
    encoding: str

    @property
    def read_as(self) -> str:
        """The ROS 2 type whose fields its messages get."""
        return foxglove.read_as(self.type)

    @property
    def encodings(self) -> tuple[str, ...]:
        """The encodings in which its type is read."""
        return foxglove.encodings(self.type)

    @property
    def is_misnamed(self) -> bool:
        """Whether it is called /tf or /tf_static and has no transforms."""
        is_transforms = self.type in _TRANSFORMS or foxglove.is_transforms(self.type)
        return self.name in (TF_STATIC, TF) and not is_transforms

    @property
    def is_ros_tf(self) -> bool:
        """Whether it is /tf, or that of a robot among several."""
        return self.type in _TRANSFORMS and self.name.endswith(TF)

    @property
    def is_foxglove_tf(self) -> bool:
        """Whether it has transforms of Foxglove's, which may have any name, and stand for /tf and /tf_static."""
        return foxglove.is_transforms(self.type) and self.encoding in self.encodings


class RawMessage(NamedTuple):
    """One message, not yet decoded.

    Attributes:
        topic: The topic that was asked for: of transforms /tf or /tf_static, whatever their topic is called.
        log_time_ns: The time it was logged.
        data: Its bytes.
        type: Its type, as of `Topic`.
        encoding: How it is serialized.
        definition: What the file says of its type.
        restamped: Whether its headers get the time it was logged, in place of their own stamps.
        problem: Why its bytes could not be unpacked; empty where they could.
    """

    topic: str
    log_time_ns: int
    data: bytes
    type: str
    encoding: str
    definition: bytes
    restamped: bool = False
    problem: str = ""

    def decode(self) -> SimpleNamespace:
        """Its fields, named as in ROS 2. What it raises where it is damaged depends on the encoding."""
        if self.problem:
            raise SequenceError(self.problem)
        message = serializations.decoder(self.type, self.encoding, self.definition)(self.data)
        if self.restamped:
            sec, nanosec = divmod(self.log_time_ns, 1_000_000_000)
            for stamped in getattr(message, "transforms", [message]):
                if hasattr(stamped, "header"):
                    stamped.header.stamp = SimpleNamespace(sec=sec, nanosec=nanosec)
        return message


@runtime_checkable
class MessageSource(Protocol):
    """Raw messages by topic: whoever reads them knows neither files nor networks."""

    @property
    def path(self) -> Path:
        """What messages of errors call it."""
        ...

    @property
    def is_running(self) -> bool:
        """Whether it goes on: then what is damaged is left out, and is no error."""
        ...

    @property
    def topics(self) -> Mapping[str, Topic]:
        """Topics by name; without those that are misnamed, which nobody could ask for."""
        ...

    def fixed_links(self) -> frozenset[tuple[str, str]]:
        """Of Foxglove's transforms, see `fixed_links_of`."""
        ...

    def __contains__(self, topic: str) -> bool:
        """Whether messages of a topic can be asked for."""
        ...

    def messages(
        self, topics: Collection[str], *, until: Callable[[int], bool] = lambda log_time_ns: False
    ) -> Iterator[RawMessage]:
        """Messages of some topics, in the order in which they lie in a file or were heard.

        Args:
            topics: Names of topics.
            until: Whether messages of a topic from a log time on are not wanted.
        """
        ...


def namespaced_tf(topics: Mapping[str, Topic], tf_topic: str | None, path: Path) -> dict[str, str]:
    """Which topics are tf under another name, as of a robot among several: /robot1/tf, and /robot1/tf_static beside it.

    Args:
        topics: All there are.
        tf_topic: The one to take; None: where there is no /tf, the only one of such a name.
        path: What messages of errors call what has them.

    Returns:
        /tf and /tf_static by the names of the topics that stand for them; empty where these are there themselves.

    Raises:
        NotFoundError: the one to take is not there.
    """
    named = sorted(name for name, topic in topics.items() if topic.is_ros_tf)
    if tf_topic == TF:
        return {}
    if tf_topic is None:
        if TF in topics or len(named) != 1:
            return {}
        (tf_topic,) = named
    elif tf_topic not in named:
        found = ", ".join(named) or "none"
        raise NotFoundError(f"{path}: no tf on {quoted(tf_topic)} (--tf-topic), found: {found}; expected one of these")
    static = tf_topic.removesuffix(TF) + TF_STATIC
    names = {tf_topic: TF} | ({static: TF_STATIC} if static in topics else {})
    return {name: stands_for for name, stands_for in names.items() if name != stands_for}


def stands_for(topic: Topic, tf: Mapping[str, str]) -> tuple[str, ...]:
    """The names under which the messages of a topic can be asked for, by `namespaced_tf`."""
    if topic.is_foxglove_tf:
        return TF_STATIC, TF
    if topic.name not in tf and topic.name in tf.values():
        return ()
    return (tf.get(topic.name, topic.name),)


def link_of(stamped: SimpleNamespace) -> tuple[str, str]:
    """Names of parent and child of geometry_msgs/TransformStamped."""
    return frame_name(stamped.header.frame_id), frame_name(stamped.child_frame_id)


def fixed_links_of(source: MessageSource) -> frozenset[tuple[str, str]]:
    """Parent and child of those of Foxglove's transforms that say the same from the first message to the last.

    Foxglove has no topic for what never changes; a transform that is told only once holds throughout.
    """
    first: dict[tuple[str, str], SimpleNamespace] = {}
    moving: set[tuple[str, str]] = set()
    if not any(topic.is_foxglove_tf for topic in source.topics.values()):
        return frozenset()
    for raw in source.messages([TF]):
        try:
            message = raw.decode()
        except Exception:  # said where it is used
            continue
        for stamped in message.transforms:
            link = link_of(stamped)
            if first.setdefault(link, stamped.transform) != stamped.transform:
                moving.add(link)
    return frozenset(first.keys() - moving)
