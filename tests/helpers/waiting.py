"""A system that changes as time passes while somebody waits for it."""

import queue
from collections.abc import Callable
from typing import Any

from sequences.live.opening import open_live
from sequences.live.reader import LiveReader
from sequences.options import OdometryUse, ReadingOptions
from sequences.recordings.source import TF_STATIC, RawMessage
from tests.helpers.fake_transport import FakeTransport


class Ended(Exception):
    """A person wants to wait no longer."""


class Wait(queue.SimpleQueue[Any]):
    """The events of a system that changes as time passes, which it does while somebody waits for an event."""

    def __init__(self, raws: list[RawMessage]) -> None:
        self.raws, self.transport = raws, FakeTransport()
        self.changes: list[tuple[float, Callable[[], Any]]] = []  # seconds after the begin, and what happens then
        self.now_s = 0.0
        self.said: list[tuple[float, str]] = []
        self.admitted: list[Any] = []

    def get(self, block: bool = True, timeout: float | None = None) -> Any:
        assert timeout is not None
        assert timeout > 0
        assert self.now_s < 100, self.said
        while self.changes and self.changes[0][0] <= self.now_s:
            self.changes.pop(0)[1]()
        if self.empty():
            self.now_s += timeout
            raise queue.Empty
        return super().get(block, timeout)

    def offer(self, *topics: str) -> None:
        for raw in self.raws:
            if raw.topic in topics:
                self.transport.offer(raw.topic, raw.type, latched=raw.topic == TF_STATIC)

    def say(self, *topics: str) -> None:
        for raw in self.raws:
            if raw.topic in topics:
                self.transport.say(raw)

    def open(
        self, options: ReadingOptions | None = None, *, leave_out: str = "", odometry: OdometryUse = "required"
    ) -> LiveReader:
        """Open what messages tell, but for those of one topic."""

        def admit(event: Any) -> RawMessage | None:
            self.admitted.append(event)
            if event == "end":
                raise Ended
            return event if isinstance(event, RawMessage) and event.topic != leave_out else None

        def waiting(problem: str) -> None:
            self.said.append((self.now_s, problem))

        options = options or ReadingOptions()
        return open_live(self.transport, self, options, admit=admit, waiting=waiting, odometry=odometry)
