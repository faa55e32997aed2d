"""What goes on, served to Foxglove by a WebSocket: the same messages as in ROS 2 and in files."""

from __future__ import annotations

import logging
from types import TracebackType
from typing import Any

from filtering.errors import VaporTrackError
from sequences.recordings.message_definitions import DEFINITIONS, schema_name, schema_text
from sequences.recordings.source import RawMessage


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
        logging.getLogger("foxglove").setLevel(logging.ERROR)
        self._foxglove = foxglove
        self._context = foxglove.Context()
        try:
            self._server = foxglove.start_server(name="vapor-track", host=host, port=port, context=self._context)
        except Exception as error:  # RuntimeError and OSError, by its version
            raise VaporTrackError(
                f"port {port} of {host} cannot be opened for Foxglove: {error} (--foxglove-port takes another)"
            ) from error
        self._channels: dict[tuple[str, str], Any] = {}

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
        if (channel := self._channels[key]) is not None:
            channel.log(raw.data, log_time=raw.log_time_ns)

    def _channel(self, raw: RawMessage) -> Any:
        if raw.type not in DEFINITIONS:
            return None
        schema = self._foxglove.Schema(
            name=schema_name(raw.type), encoding="ros2msg", data=schema_text(raw.type).encode()
        )
        return self._foxglove.Channel(raw.topic, schema=schema, message_encoding=raw.encoding, context=self._context)
