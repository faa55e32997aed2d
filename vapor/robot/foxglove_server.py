"""What goes on, served to Foxglove by a WebSocket: the same messages as in ROS 2 and in files."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from types import TracebackType
from typing import Any

from filtering.errors import VaporTrackError
from sequences.recordings.message_definitions import DEFINITIONS, schema_name, schema_text
from sequences.recordings.source import TF_STATIC, RawMessage

_MOST_LATCHED = 100


class _Late:
    """Listens to who begins to listen, in a thread of the server."""

    def __init__(self, repeat: Callable[[str], None]) -> None:
        self._repeat = repeat

    def on_subscribe(self, client: object, channel: Any) -> None:
        """Somebody did."""
        self._repeat(channel.topic)

    def on_unsubscribe(self, client: object, channel: object) -> None:
        """Somebody does no longer."""


class FoxgloveServer:
    """A WebSocket server for Foxglove; used in a `with` block.

    Args:
        host: Address to serve on.
        port: Port to serve on; 0 for any that is free.

    Raises:
        VaporTrackError: foxglove-sdk is not installed, or the port is in use or cannot be opened.
    """

    def __init__(self, host: str, port: int) -> None:
        try:
            import foxglove
        except ImportError as error:
            raise VaporTrackError(
                "foxglove-sdk is not installed, expected it for --foxglove: pip install vapor-track[live]"
            ) from error
        for name in ("foxglove", "tungstenite"):  # without handlers, Python prints of clients that break off
            logging.getLogger(name).addHandler(logging.NullHandler())
        self._foxglove = foxglove
        self._context = foxglove.Context()
        self._channels: dict[tuple[str, str], Any] = {}
        self._latched: dict[str, list[RawMessage]] = {}
        self._lock = threading.Lock()
        late: Any = _Late(self._repeat)
        try:
            self._server = foxglove.start_server(
                name="vapor-track", host=host, port=port, context=self._context, server_listener=late
            )
        except Exception as error:  # RuntimeError and OSError, by its version
            option = "--foxglove-port takes another" if "in use" in str(error) else "--foxglove-host, --foxglove-port"
            raise VaporTrackError(f"port {port} of {host} cannot be opened for Foxglove: {error} ({option})") from error

    @property
    def port(self) -> int:
        """Where it listens."""
        return self._server.port

    def __enter__(self) -> FoxgloveServer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._server.stop()

    def write(self, raw: RawMessage) -> None:
        """Serve a message to those who watch."""
        key = raw.topic, raw.type
        if key not in self._channels:
            self._channels[key] = self._channel(raw)
        if raw.topic == TF_STATIC:  # told once, and of several nodes
            with self._lock:
                kept = self._latched.setdefault(raw.topic, [])
                if all(raw.data != before.data for before in kept):
                    kept.append(raw)
                    del kept[:-_MOST_LATCHED]
        if (channel := self._channels[key]) is not None:
            channel.log(raw.data, log_time=raw.log_time_ns)

    def _repeat(self, topic: str) -> None:
        """Tell again what is told only once, as somebody begins to listen."""
        with self._lock:
            kept = list(self._latched.get(topic, []))
        for raw in kept:
            self._channels[raw.topic, raw.type].log(raw.data, log_time=raw.log_time_ns)

    def _channel(self, raw: RawMessage) -> Any:
        if raw.type not in DEFINITIONS:
            return None
        schema = self._foxglove.Schema(
            name=schema_name(raw.type), encoding="ros2msg", data=schema_text(raw.type).encode()
        )
        return self._foxglove.Channel(raw.topic, schema=schema, message_encoding=raw.encoding, context=self._context)
