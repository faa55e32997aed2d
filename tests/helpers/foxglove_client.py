"""A client of Foxglove's WebSocket protocol, in the standard library."""

import base64
import json
import os
import select
import socket
import struct
import time
from collections.abc import Callable
from typing import Any, NamedTuple

_TEXT, _BINARY, _CLOSE, _PING, _PONG = 1, 2, 8, 9, 10
_MESSAGE = 1  # of the server's binary frames
_SUBSCRIPTION = 7


class Served(NamedTuple):
    """A served message: its log time in nanoseconds, and its bytes."""

    log_time_ns: int
    data: bytes


class FoxgloveClient:
    """Connected to a server on this machine; used in a `with` block.

    Attributes:
        channels: Offered channels by topic.
    """

    def __init__(self, port: int) -> None:
        self._socket = socket.create_connection(("127.0.0.1", port), timeout=10)
        key = base64.b64encode(os.urandom(16)).decode()
        request = (
            f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            f"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: {key}\r\n"
            "Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n"
        )
        self._socket.sendall(request.encode())
        answer = b""
        while not answer.endswith(b"\r\n\r\n"):
            answer += self._read(1)
        assert answer.lower().startswith(b"http/1.1 101"), answer
        assert b"sec-websocket-protocol: foxglove.sdk.v1" in answer.lower()
        self.channels: dict[str, dict[str, Any]] = {}
        self._messages: list[Served] = []

    def __enter__(self) -> "FoxgloveClient":
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()

    def wait_for(self, *topics: str) -> None:
        end_s = time.monotonic() + 10
        while not {*topics} <= self.channels.keys():
            assert time.monotonic() < end_s, f"{topics} are not offered"
            self._take()

    def subscribe(self, topic: str) -> None:
        subscription = {"id": _SUBSCRIPTION, "channelId": self.channels[topic]["id"]}
        self._send(_TEXT, json.dumps({"op": "subscribe", "subscriptions": [subscription]}).encode())

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
            if select.select([self._socket], [], [], 0.05)[0]:
                self._take()
        return self._messages.pop(0)

    def vanish(self) -> None:
        """Close without a farewell, as a browser that is killed."""
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        self._socket.close()

    def _take(self) -> None:
        first, size = self._read(2)
        if size >= 126:
            (size,) = struct.unpack(">H" if size == 126 else ">Q", self._read(2 if size == 126 else 8))
        kind, data = first & 0x0F, self._read(size)
        if kind == _TEXT:
            content = json.loads(data)
            if content["op"] == "advertise":
                self.channels |= {channel["topic"]: channel for channel in content["channels"]}
        elif kind == _BINARY and data[0] == _MESSAGE:
            _, subscription, log_time_ns = struct.unpack_from("<BIQ", data)
            assert subscription == _SUBSCRIPTION
            self._messages.append(Served(log_time_ns, data[13:]))
        elif kind == _PING:
            self._send(_PONG, data)
        assert kind != _CLOSE

    def _read(self, size: int) -> bytes:
        data = b""
        while len(data) < size:
            got = self._socket.recv(size - len(data))
            assert got, "the server hung up"
            data += got
        return data

    def _send(self, kind: int, data: bytes) -> None:
        size = bytes([0x80 | len(data)]) if len(data) < 126 else struct.pack(">BH", 0x80 | 126, len(data))
        mask = os.urandom(4)
        masked = bytes(byte ^ mask[i % 4] for i, byte in enumerate(data))
        self._socket.sendall(bytes([0x80 | kind]) + size + mask + masked)
