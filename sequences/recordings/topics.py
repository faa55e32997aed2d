"""Topics of a bag: which plays which role, and what its messages say."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import accumulate
from types import SimpleNamespace

from sequences.errors import NotFoundError, SequenceError
from sequences.recordings import foxglove
from sequences.recordings.source import TF_STATIC, MessageSource, RawMessage, Topic, link_of

_LISTED = 120  # characters of names and types


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

    Args:
        bag: The recording.
        role: What it is for, as in the name of its option.
        types: ROS 2 types as which its messages may be read.
        name: Its name; None to find it.
        required: Whether to fail where there is none.
        besides: Name of a topic that has another role, and is not found.

    Raises:
        NotFoundError: no topic of that name, or none of these types.
        SequenceError: one of another type or encoding, or several where none is named.
    """
    others = f" or {len(types) - 2} others" if len(types) > 2 else ""
    option, expected = f"--{role}-topic", " or ".join(types[:2]) + others
    if name == "" and not required:
        return None
    if name:
        if name not in bag.topics:
            raise NotFoundError(f"{bag.path}: no topic {name} ({option}); {listing(bag.topics.values())}")
        chosen = bag.topics[name]
        if chosen.read_as not in types:
            raise SequenceError(f"{bag.path}: {name} is {chosen.type}, expected {expected} for {option}")
    else:
        known = [topic for topic in bag.topics.values() if topic.name != besides]
        candidates = [topic for topic in known if topic.read_as in types and topic.num_messages]
        if not candidates and not required:
            return None
        if not candidates:
            robots = [topic.name for topic in bag.topics.values() if topic.is_ros_tf]
            of_one = f"; tf is of {len(robots)} robots, name one by --tf-topic" if len(robots) > 1 else ""
            raise NotFoundError(
                f"{bag.path}: no {role} topic, expected one of type {expected}{of_one}; {listing(bag.topics.values())}"
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


def listing(topics: Iterable[Topic]) -> str:
    """Topics with their types, for messages of errors: as many as fit there, and how many more."""
    found = [f"{topic.name} ({topic.type})" for topic in topics]
    fitting = [text for text, end in zip(found, accumulate(map(len, found)), strict=True) if end <= _LISTED]
    more = f" and {len(found) - len(fitting)} more" if len(fitting) < len(found) else ""
    return f"found {', '.join(fitting)}{more}" if found else "found no topics"


def decode(bag: MessageSource, raw: RawMessage, *, tolerate: bool = False) -> SimpleNamespace | None:
    """Fields of a message; where its bytes are no such message, an error or, if tolerated, None.

    Of Foxglove's transforms, those that never change are on /tf_static, the others on /tf.
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


def first(bag: MessageSource, topic: Topic) -> SimpleNamespace:
    """First message of a topic that can be decoded. Raises NotFoundError where there is none."""
    for raw in bag.messages([topic.name]):
        if (message := decode(bag, raw, tolerate=True)) is not None:
            return message
    raise NotFoundError(f"{bag.path}: no readable message on {topic.name} ({topic.type}), expected at least one")
