"""A client of Foxglove's WebSocket protocol, in the standard library: what a test sees of what is served."""

import base64
import json
import os
import socket
import struct
import time
from collections.abc import Callable
from types import TracebackType
from typing import Any, NamedTuple

_TEXT, _BINARY, _CLOSE, _PING, _PONG = 1, 2, 8, 9, 10
_MESSAGE = 1  # of the server's binary frames
_SUBSCRIPTION = 7


class Served(NamedTuple):
    """A message as it was served: when it was logged, in nanoseconds, and its bytes."""

    log_time_ns: int
    data: bytes


class FoxgloveClient:
    """Connected to a server on this machine; used in a `with` block.

    Attributes:
        info: What the server says of itself.
        channels: What it offers, by topic.
    """

    def __init__(self, port: int) -> None:
        self._socket = socket.create_connection(("127.0.0.1", port), timeout=10)
        key = base64.b64encode(os.urandom(16)).decode()
        lines = [
            "GET / HTTP/1.1",
            f"Host: 127.0.0.1:{port}",
            "Upgrade: websocket",
            "Connection: Upgrade",
            "Sec-WebSocket-Version: 13",
            f"Sec-WebSocket-Key: {key}",
            "Sec-WebSocket-Protocol: foxglove.sdk.v1",
        ]
        self._socket.sendall(("\r\n".join(lines) + "\r\n\r\n").encode())
        self._bytes = b""
        answer = self._read_until(b"\r\n\r\n").decode().lower()
        assert answer.startswith("http/1.1 101"), answer
        assert "sec-websocket-protocol: foxglove.sdk.v1" in answer
        self.info: dict[str, Any] = {}
        self.channels: dict[str, dict[str, Any]] = {}
        self._messages: list[Served] = []

    def __enter__(self) -> "FoxgloveClient":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._socket.close()

    def wait_for(self, *topics: str) -> None:
        """Until they are offered."""
        self._take_until(lambda: {*topics} <= self.channels.keys(), f"{topics} to be offered")

    def subscribe(self, topic: str) -> None:
        """To a topic that is offered, one in all."""
        subscription = {"id": _SUBSCRIPTION, "channelId": self.channels[topic]["id"]}
        self._send(_TEXT, json.dumps({"op": "subscribe", "subscriptions": [subscription]}).encode())

    def message(self, write: Callable[[], None], timeout_s: float = 10.0) -> Served:
        """The first message of what it subscribed to.

        Args:
            write: Has a message served; called again and again, since nobody says when a subscription is in effect.
            timeout_s: How long to wait.
        """
        end_s = time.monotonic() + timeout_s
        self._socket.settimeout(0.05)
        while not self._messages:
            assert time.monotonic() < end_s, "no message"
            write()
            try:
                self._take()
            except TimeoutError:
                continue
        self._socket.settimeout(10)
        return self._messages.pop(0)

    def vanish(self) -> None:
        """As a browser that is killed: no farewell."""
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        self._socket.close()

    def _take_until(self, there: Callable[[], bool], what: str) -> None:
        end_s = time.monotonic() + 10
        while not there():
            assert time.monotonic() < end_s, f"expected {what}"
            self._take()

    def _take(self) -> None:
        """One frame."""
        kind, data = self._frame()
        if kind == _TEXT:
            said = json.loads(data)
            if said["op"] == "serverInfo":
                self.info = said
            elif said["op"] == "advertise":
                self.channels |= {channel["topic"]: channel for channel in said["channels"]}
        elif kind == _BINARY and data[0] == _MESSAGE:
            _, subscription, log_time_ns = struct.unpack_from("<BIQ", data)
            assert subscription == _SUBSCRIPTION
            self._messages.append(Served(log_time_ns, data[13:]))
        elif kind == _PING:
            self._send(_PONG, data)
        assert kind != _CLOSE

    def _frame(self) -> tuple[int, bytes]:
        """It is taken whole or not at all, where time runs out."""
        while True:
            have = self._bytes
            if len(have) >= 2:
                size, begin = have[1] & 0x7F, 2
                if size == 126 and len(have) >= 4:
                    size, begin = struct.unpack_from(">H", have, 2)[0], 4
                elif size == 127 and len(have) >= 10:
                    size, begin = struct.unpack_from(">Q", have, 2)[0], 10
                elif size >= 126:
                    size, begin = len(have), 2  # the rest of the header is missing
                if len(have) >= begin + size:
                    self._bytes = have[begin + size :]
                    return have[0] & 0x0F, have[begin : begin + size]
            self._read()

    def _read_until(self, end: bytes) -> bytes:
        while end not in self._bytes:
            self._read()
        head, self._bytes = self._bytes.split(end, 1)
        return head

    def _read(self) -> None:
        got = self._socket.recv(1 << 16)
        assert got, "the server hung up"
        self._bytes += got

    def _send(self, kind: int, data: bytes) -> None:
        size = bytes([0x80 | len(data)]) if len(data) < 126 else struct.pack(">BH", 0x80 | 126, len(data))
        mask = os.urandom(4)
        masked = bytes(byte ^ mask[i % 4] for i, byte in enumerate(data))
        self._socket.sendall(bytes([0x80 | kind]) + size + mask + masked)
