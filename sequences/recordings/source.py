"""Raw messages by topic, of a recording or of a running system, and the choice among topics."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from itertools import accumulate
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Literal, NamedTuple, Protocol, runtime_checkable

from filtering.errors import listed, quoted
from sequences.errors import NotFoundError, SequenceError
from sequences.recordings import foxglove, serializations
from sequences.recordings.messages import frame_name

Stamps = Literal["header", "log"]
TF_STATIC, TF = "/tf_static", "/tf"
_TRANSFORMS = ("tf2_msgs/TFMessage", "tf/tfMessage")
_LISTED = 120  # characters of names and types in an error


@dataclass(frozen=True)
class Topic:
    """One topic, with the number of its messages in all files and their serialization; ROS 2 has "cdr".

    The type is that of the file, without `/msg`: `nav_msgs/Odometry`, `foxglove.PoseInFrame`.
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
        """Whether it is called /tf or /tf_static without having transforms."""
        is_transforms = self.type in _TRANSFORMS or foxglove.is_transforms(self.type)
        return self.name in (TF_STATIC, TF) and not is_transforms

    @property
    def is_ros_tf(self) -> bool:
        """Whether it is /tf of ROS, or that of a robot among several."""
        return self.type in _TRANSFORMS and self.name.endswith(TF)

    @property
    def is_foxglove_tf(self) -> bool:
        """Whether it has Foxglove's transforms, which may have any name, and stand for /tf and /tf_static."""
        return foxglove.is_transforms(self.type) and self.encoding in self.encodings


class RawMessage(NamedTuple):
    """One message, not yet decoded.

    Attributes:
        topic: The topic that was asked for; of transforms /tf or /tf_static.
        definition: The file's definition of its type.
        restamped: Whether its headers get the log time in place of their own stamps.
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

    def decode(self) -> Any:
        """Its fields, named as in ROS 2. A damaged one raises any exception, by its encoding."""
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
    """Raw messages by topic, of files or a network."""

    @property
    def path(self) -> Path:
        """Its name in errors."""
        ...

    @property
    def topics(self) -> Mapping[str, Topic]:
        """Topics by name; without misnamed ones, see `Topic.is_misnamed`."""
        ...

    def fixed_links(self) -> frozenset[tuple[str, str]]:
        """See `fixed_links_of`."""
        ...

    def __contains__(self, topic: str) -> bool:
        """Whether messages of a topic can be asked for."""
        ...

    def messages(
        self, topics: Collection[str], *, until: Callable[[int], bool] = lambda log_time_ns: False
    ) -> Iterator[RawMessage]:
        """Messages of some topics, in their order; those of a topic end where `until` is true of a log time."""
        ...


def namespaced_tf(topics: Mapping[str, Topic], tf_topic: str | None, path: Path) -> dict[str, str]:
    """The topics that stand for tf, as of a robot among several: /robot1/tf, and /robot1/tf_static beside it.

    Without `tf_topic` it is the only one of such a name, where there is no /tf. Returns /tf and /tf_static by the names
    of those topics, empty where they stand for themselves. Raises NotFoundError where `tf_topic` is missing.
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


def link_of(stamped: Any) -> tuple[str, str]:
    """Names of parent and child of geometry_msgs/TransformStamped."""
    return frame_name(stamped.header.frame_id), frame_name(stamped.child_frame_id)


def fixed_links_of(source: MessageSource) -> frozenset[tuple[str, str]]:
    """Parent and child of Foxglove's transforms that never change; one that comes only once holds throughout."""
    first: dict[tuple[str, str], Any] = {}
    moving: set[tuple[str, str]] = set()
    if not any(topic.is_foxglove_tf for topic in source.topics.values()):
        return frozenset()
    for raw in source.messages([TF]):
        try:
            message = raw.decode()
        except Exception:  # reported where it is used
            continue
        for stamped in message.transforms:
            link = link_of(stamped)
            if first.setdefault(link, stamped.transform) != stamped.transform:
                moving.add(link)
    return frozenset(first.keys() - moving)


def choose(
    bag: MessageSource,
    role: str,
    types: tuple[str, ...],
    name: str | None,
    *,
    required: bool = False,
    besides: str | None = None,
) -> Topic | None:
    """The topic named, or the only one of its types; None where the name is '', or there is none and none is required.

    Types are those of ROS 2 as which messages may be read; the `role` is as in the name of its option. A topic
    `besides` has another role, and is not found. Raises SequenceError for one of another type or encoding and for
    several, and NotFoundError for none.
    """
    option, expected = f"--{role}-topic", " or ".join(filter(None, [", ".join(types[:-1]), types[-1]]))
    if name == "" and not required:
        return None
    if name:
        if name not in bag.topics:
            fitting_first = sorted(bag.topics.values(), key=lambda topic: topic.read_as not in types)
            near = get_close_matches(name, [topic.name for topic in fitting_first if topic.read_as in types], 1)
            meant = f"; did you mean {near[0]}?" if near else ""
            raise NotFoundError(f"{bag.path}: no topic {name} ({option}); {listing(fitting_first)}{meant}")
        chosen = bag.topics[name]
        if chosen.read_as not in types:
            raise SequenceError(f"{bag.path}: {name} is {chosen.type}, expected {expected} for {option}")
    else:
        known = [topic for topic in bag.topics.values() if topic.name != besides]
        candidates = [topic for topic in known if topic.read_as in types and topic.num_messages]
        if not candidates and not required:
            return None
        if not candidates:
            without = ", so no images;" if role == "image" else ","
            raise NotFoundError(
                f"{bag.path}: no{other_than(bag, besides, types)} {role} topic{without} expected one of type"
                f" {expected}{several_robots(bag)}; {listing(known)}"
            )
        if len(candidates) > 1:
            none = "" if required else ", or '' for none"
            raise SequenceError(
                f"{bag.path}: {len(candidates)} {role} topics, expected one; name it by {option}{none};"
                f" {listing(candidates)}"
            )
        chosen = candidates[0]
    if chosen.encoding not in chosen.encodings:
        raise SequenceError(
            f"{bag.path}: {chosen.name} ({chosen.type}) is encoded as {chosen.encoding!r}, expected"
            f" {' or '.join(map(repr, chosen.encodings))}"
        )
    return chosen


def other_than(bag: MessageSource, name: str | None, types: tuple[str, ...]) -> str:
    """The part of "no other topic" that says that this one is of these types, and has another role; else empty."""
    return " other" if name is not None and name in bag.topics and bag.topics[name].read_as in types else ""


def several_robots(bag: MessageSource) -> str:
    """The part of a sentence that asks which robot's tf to read; empty where there is one at most."""
    robots = sum(topic.is_ros_tf for topic in bag.topics.values())
    return f"; tf is of {robots} robots, name one by --tf-topic" if robots > 1 else ""


def listing(topics: Iterable[Topic]) -> str:
    """Topics with their types, for errors: as many as fit, and the number of others."""
    found = [f"{topic.name} ({topic.type}{', empty' * (not topic.num_messages)})" for topic in topics]
    fitting = [text for text, end in zip(found, accumulate(map(len, found)), strict=True) if end <= _LISTED]
    return f"found {listed(found, len(fitting))}" if found else "found no topics"


def decode(bag: MessageSource, raw: RawMessage, *, tolerate: bool = False) -> Any:
    """Fields of a message. Undecodable bytes raise SequenceError or, if tolerated, give None.

    Foxglove's transforms are on /tf_static where they never change, else on /tf.
    """
    try:
        message = raw.decode()
    except Exception as error:  # the libraries let struct, index and unicode errors through
        if tolerate:
            return None
        reason = str(error) if isinstance(error, SequenceError) else f"{type(error).__name__}: {error}"
        raise SequenceError(
            f"{bag.path}: {raw.topic}: message logged at {raw.log_time_ns} ns has {len(raw.data)} bytes that are no"
            f" {raw.type}: {reason}"
        ) from error
    if foxglove.is_transforms(raw.type):
        static = raw.topic == TF_STATIC
        message.transforms = [t for t in message.transforms if (link_of(t) in bag.fixed_links()) == static]
    return message


def first(bag: MessageSource, topic: Topic) -> Any:
    """The first readable message of a topic. Raises NotFoundError where there is none."""
    for raw in bag.messages([topic.name]):
        if (message := decode(bag, raw, tolerate=True)) is not None:
            return message
    raise NotFoundError(f"{bag.path}: no readable message on {topic.name} ({topic.type}), expected at least one")
