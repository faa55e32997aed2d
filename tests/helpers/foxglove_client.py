"""A client of Foxglove's WebSocket protocol."""

import asyncio
import json
import struct
import time
from collections.abc import Callable
from typing import Any, NamedTuple

from tornado.ioloop import IOLoop
from tornado.websocket import websocket_connect

_MESSAGE = 1  # of the server's binary frames
_SUBSCRIPTION = 7


class Served(NamedTuple):
    """A served message: its log time in nanoseconds, and its bytes."""

    log_time_ns: int
    data: bytes


class FoxgloveClient:
    """Connected to a server on this machine; used in a `with` block. `channels` are those offered, by topic."""

    def __init__(self, port: int) -> None:
        self._loop = IOLoop(make_current=False)
        self._connection = self._loop.run_sync(
            lambda: websocket_connect(f"ws://127.0.0.1:{port}", subprotocols=["foxglove.sdk.v1"]), timeout=10
        )
        assert self._connection.selected_subprotocol == "foxglove.sdk.v1"
        self._next: Any = None
        self.channels: dict[str, dict[str, Any]] = {}
        self._messages: list[Served] = []

    def __enter__(self) -> "FoxgloveClient":
        return self

    def __exit__(self, *_: object) -> None:
        async def leave() -> None:
            self._connection.close()

        self._loop.run_sync(leave)
        self._loop.close()

    def wait_for(self, topic: str) -> None:
        end_s = time.monotonic() + 10
        while topic not in self.channels:
            assert time.monotonic() < end_s, f"{topic} is not offered"
            self._take()

    def subscribe(self, topic: str) -> None:
        subscription = {"id": _SUBSCRIPTION, "channelId": self.channels[topic]["id"]}
        text = json.dumps({"op": "subscribe", "subscriptions": [subscription]})
        self._loop.run_sync(lambda: self._connection.write_message(text))

    def message(self, write: Callable[[], None], timeout_s: float = 10.0) -> Served:
        """The first message of the subscription.

        Args:
            write: Has a message served; called repeatedly, as no answer states when a subscription takes effect.
            timeout_s: How long to wait.
        """
        end_s = time.monotonic() + timeout_s
        while not self._messages:
            assert time.monotonic() < end_s, "no message"
            write()
            self._take()
        return self._messages.pop(0)

    def vanish(self) -> None:
        """Close without a farewell, as a browser that is killed."""
        self._connection.protocol.stream.close()

    def _take(self) -> None:
        """Take what the server sends next, if it does at once."""

        async def receive() -> None:
            self._next = self._next or asyncio.ensure_future(self._connection.read_message())
            await asyncio.wait({self._next}, timeout=0.05)

        self._loop.run_sync(receive)
        if not self._next.done():
            return
        data, self._next = self._next.result(), None
        assert data is not None, "the server hung up"
        if isinstance(data, str):
            content = json.loads(data)
            if content["op"] == "advertise":
                self.channels |= {channel["topic"]: channel for channel in content["channels"]}
        elif data[0] == _MESSAGE:
            _, subscription, log_time_ns = struct.unpack_from("<BIQ", data)
            assert subscription == _SUBSCRIPTION
            self._messages.append(Served(log_time_ns, data[13:]))
