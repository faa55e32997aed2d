"""Viewers of live localization: Foxglove by a WebSocket, and Rerun in a thread that never delays the loop."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from types import SimpleNamespace, TracebackType
from typing import Any

from filtering.errors import VaporTrackError
from filtering.estimate import Estimate
from filtering.se3 import Poses
from sequences.frame import Frame
from sequences.recordings.message_definitions import is_known, schema_name, schema_text
from sequences.recordings.source import TF_STATIC, RawMessage
from vapor.reporting.rerun_viewer import RerunViewer

_MOST_LATCHED = 100
_LEAVE_S = 3.0  # that a viewer gets at the end


class FoxgloveServer:
    """A WebSocket server for Foxglove; used in a `with` block. Port 0 takes any free one.

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
        for name in ("foxglove", "tungstenite"):  # without handlers, Python prints errors of clients
            logging.getLogger(name).addHandler(logging.NullHandler())
        self._foxglove = foxglove
        self._context = foxglove.Context()
        self._channels: dict[tuple[str, str], Any] = {}
        self._latched: dict[str, list[RawMessage]] = {}
        self._lock = threading.Lock()
        listener: Any = SimpleNamespace(on_subscribe=self._repeat, on_unsubscribe=lambda client, channel: None)
        try:
            self._server = foxglove.start_server(
                name="vapor-track", host=host, port=port, context=self._context, server_listener=listener
            )
        except Exception as error:  # RuntimeError and OSError, by its version
            option = "--foxglove-port takes another" if "in use" in str(error) else "--foxglove-host, --foxglove-port"
            raise VaporTrackError(f"port {port} of {host} cannot be opened for Foxglove: {error} ({option})") from error

    @property
    def port(self) -> int:
        """Its port."""
        return self._server.port

    def __enter__(self) -> FoxgloveServer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._server.stop()

    def write(self, raw: RawMessage) -> None:
        """Serve a message to the subscribers."""
        key = raw.topic, raw.type
        if key not in self._channels:
            self._channels[key] = None
            if is_known(raw.type):
                schema = self._foxglove.Schema(
                    name=schema_name(raw.type), encoding="ros2msg", data=schema_text(raw.type).encode()
                )
                self._channels[key] = self._foxglove.Channel(
                    raw.topic, schema=schema, message_encoding=raw.encoding, context=self._context
                )
        if raw.topic == TF_STATIC:  # sent once, by several nodes
            with self._lock:
                kept = self._latched.setdefault(raw.topic, [])
                if all(raw.data != before.data for before in kept):
                    kept.append(raw)
                    del kept[:-_MOST_LATCHED]
        if (channel := self._channels[key]) is not None:
            channel.log(raw.data, log_time=raw.log_time_ns)

    def _repeat(self, client: object, channel: Any) -> None:
        with self._lock:
            kept = list(self._latched.get(channel.topic, []))
        for raw in kept:
            self._channels[raw.topic, raw.type].log(raw.data, log_time=raw.log_time_ns)


class WatchingViewer:
    """Shows estimates in a thread; a viewer slower than the camera skips images, and one that fails is given up.

    `opened` is called here, so that its errors come at once; `notify` once, when the viewer fails.
    """

    def __init__(self, opened: Callable[[], RerunViewer], notify: Callable[[str], None]) -> None:
        self._viewer, self._notify = opened(), notify
        self._newest: tuple[Frame, Estimate, Poses | None] | None = None
        self._closed = False
        self._turn = threading.Condition()
        self._thread = threading.Thread(target=self._work, name="viewer", daemon=True)
        self._thread.start()

    def log(self, frame: Frame, estimate: Estimate, posterior_poses: Poses | None) -> None:
        """Show this image next, in place of any that waits."""
        with self._turn:
            self._newest = frame, estimate, posterior_poses
            self._turn.notify()

    def close(self) -> None:
        """Stop showing."""
        with self._turn:
            self._closed = True
            self._turn.notify()
        self._thread.join(_LEAVE_S)

    def __enter__(self) -> WatchingViewer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _work(self) -> None:
        try:
            while True:
                with self._turn:
                    self._turn.wait_for(lambda: self._closed or self._newest is not None)
                    shown, self._newest = self._newest, None
                if shown is None:
                    break
                self._viewer.log(*shown)
            self._viewer.close()
        except VaporTrackError as error:
            self._notify(f"the viewer stopped: {error}")
