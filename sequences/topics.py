"""Topics of a bag: which plays which role, and what its messages say."""

from __future__ import annotations

from collections.abc import Iterable
from types import SimpleNamespace

from sequences.bag import Bag, RawMessage, Topic
from sequences.errors import SequenceError
from sequences.message_definitions import decoder


def choose(
    bag: Bag, role: str, types: tuple[str, ...], name: str | None, *, required: bool = False, besides: str | None = None
) -> Topic | None:
    """The topic named, or the only one of its types; None where the name is '', or there is none and none is required.

    Args:
        bag: The recording.
        role: What it is for, as in the name of its option.
        types: Message types that it may have.
        name: Its name; None to find it.
        required: Whether to fail where there is none.
        besides: Name of a topic that has another role, and is not found.

    Raises:
        SequenceError: no topic of that name, one of another type or not in CDR, or several where none is named.
    """
    option, expected = f"--{role}-topic", " or ".join(types)
    if name == "" and not required:
        return None
    if name:
        if name not in bag.topics:
            raise SequenceError(f"{bag.path}: no topic {name} ({option}); {listing(bag.topics.values())}")
        chosen = bag.topics[name]
        if chosen.type not in types:
            raise SequenceError(f"{bag.path}: {name} is {chosen.type}, expected {expected} for {option}")
    else:
        known = [topic for topic in bag.topics.values() if topic.name != besides]
        candidates = [topic for topic in known if topic.type in types and topic.num_messages]
        if not candidates and not required:
            return None
        if not candidates:
            raise SequenceError(
                f"{bag.path}: no {role} topic, expected one of type {expected}; {listing(bag.topics.values())}"
            )
        if len(candidates) > 1:
            none = "" if required else ", or '' for none"
            raise SequenceError(
                f"{bag.path}: {len(candidates)} {role} topics, expected one; name it by {option}{none};"
                f" {listing(candidates)}"
            )
        chosen = candidates[0]
    if chosen.encoding != "cdr":
        raise SequenceError(f"{bag.path}: {chosen.name} is encoded as {chosen.encoding!r}, expected ROS 2's 'cdr'")
    return chosen


def listing(topics: Iterable[Topic]) -> str:
    """Topics with their types, for messages of errors."""
    return f"found {', '.join(f'{topic.name} ({topic.type})' for topic in topics) or 'no topics'}"


def decode(bag: Bag, raw: RawMessage, *, tolerate: bool = False) -> SimpleNamespace | None:
    """Fields of a message; where its bytes are no such message, an error or, if tolerated, None."""
    message_type = bag.topics[raw.topic].type
    try:
        return decoder(message_type)(raw.data)
    except Exception as error:  # the library lets struct, index and unicode errors through
        if tolerate:
            return None
        raise SequenceError(
            f"{bag.path}: {raw.topic}: message logged at {raw.log_time_ns} ns has {len(raw.data)} bytes that are no"
            f" {message_type}: {type(error).__name__}: {error}"
        ) from error


def first(bag: Bag, topic: Topic) -> SimpleNamespace:
    """First message of a topic that can be decoded. Raises SequenceError where there is none."""
    for raw in bag.messages([topic.name]):
        if (message := decode(bag, raw, tolerate=True)) is not None:
            return message
    raise SequenceError(f"{bag.path}: no readable message on {topic.name} ({topic.type}), expected at least one")
