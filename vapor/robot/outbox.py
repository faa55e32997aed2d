"""Where messages go that live localization makes: each is encoded once, and handed to whoever wants it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Protocol, runtime_checkable

from filtering.errors import VaporTrackError
from sequences.live.transport import Publish, Transport
from sequences.recordings.estimate_messages import Message
from sequences.recordings.message_definitions import encoder
from sequences.recordings.source import RawMessage


@runtime_checkable
class Sink(Protocol):
    """Takes messages as the bytes that they are in a recording."""

    def write(self, raw: RawMessage) -> None:
        """Take a message; must not wait."""
        ...


class Outbox:
    """Sends messages.

    Args:
        transport: The system that they are published in.
        sinks: Who else gets them.
        tell: Told, once, of a message that could not be published.
    """

    def __init__(self, transport: Transport, sinks: Iterable[Sink], tell: Callable[[str], None]) -> None:
        self._transport, self._sinks, self._tell = transport, list(sinks), tell
        self._publish: dict[str, Publish] = {}
        self._failed = False

    def advertise(self, topic: str, message_type: str) -> None:
        """Begin to publish a topic, so that it is known before its first message."""
        if topic not in self._publish:
            self._publish[topic] = self._transport.advertise(topic, message_type)

    def send(self, messages: Iterable[Message], now_ns: int) -> list[RawMessage]:
        """Publish messages; gives their bytes, logged now."""
        sent: list[RawMessage] = []
        for message in messages:
            self.advertise(message.topic, message.type)
            data = encoder(message.type)(message.fields)
            raw = RawMessage(message.topic, now_ns, data, message.type, "cdr", b"")
            try:
                self._publish[message.topic](data)
            except VaporTrackError as error:  # the network may be back in a moment
                if not self._failed:
                    self._failed = True
                    self._tell(f"{message.topic} could not be published: {error}")
            for sink in self._sinks:
                sink.write(raw)
            sent.append(raw)
        return sent
