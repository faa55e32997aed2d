"""Waiting for a running system, until all that a reading needs is there."""

from __future__ import annotations

import math
import queue
import time
from collections.abc import Callable, Sequence
from typing import Any

from sequences.errors import NoOdometryError, NotFoundError
from sequences.live.reader import LiveReader
from sequences.live.topic_buffer import TopicBuffer
from sequences.live.transport import Transport
from sequences.options import OdometryUse, ReadingOptions
from sequences.recordings.source import RawMessage

_SETTLED_S = 1.0  # without a new topic, before the only one of its kind is chosen
_ASK_AGAIN_S = 0.2
_REPORT_AGAIN_S = 5.0
_WITHOUT_ODOMETRY_S = 10.0  # after which the reading begins without it, where it may


def open_live(
    transport: Transport,
    events: queue.SimpleQueue[Any],
    options: ReadingOptions,
    *,
    admit: Callable[[Any], RawMessage | None],
    waiting: Callable[[str], None],
    late_window_s: float = 0.0,
    usual_cameras: Sequence[str] = (),
    odometry: OdometryUse = "required",
) -> LiveReader:
    """Wait until everything that a reading needs is there; returns its reader, with all messages so far taken.

    Args:
        transport: The system.
        events: Receives its messages, and other events.
        options: What to read.
        admit: Returns the message of an event to keep, or None; it may raise to end the wait.
        waiting: Called with the missing thing, at first and every five seconds.
        late_window_s: As of `LiveReader`.
        usual_cameras: As of `LiveReader`.
        odometry: As of `LiveReader`; "auto" ignores it where only odometry is missing for ten seconds.

    Raises:
        SequenceError: something cannot be used, or there is a choice to make.
    """
    heard = TopicBuffer(transport, events, options=options)
    changed_s, reported_s, without_s = time.monotonic(), -math.inf, math.inf
    use: OdometryUse = "required" if odometry == "auto" else odometry
    while True:
        if heard.refresh():
            changed_s = time.monotonic()
        problem = None  # not known before topics have settled
        if time.monotonic() - changed_s >= _SETTLED_S:
            try:
                reader = LiveReader(
                    heard, options, late_window_s=late_window_s, usual_cameras=usual_cameras, odometry=use
                )
            except NotFoundError as error:
                problem = str(error).removeprefix(f"{heard.path}: ")
                if odometry == "auto" and isinstance(error, NoOdometryError):  # all else is there
                    without_s = min(without_s, time.monotonic() + _WITHOUT_ODOMETRY_S)
                    use = "ignored" if time.monotonic() >= without_s else use
                    problem += f"; it goes on without odometry after {_WITHOUT_ODOMETRY_S:g} s"
            else:
                for raw in heard.kept():
                    reader.take(raw)
                return reader
        if problem is not None and time.monotonic() - reported_s >= _REPORT_AGAIN_S:
            reported_s = time.monotonic()
            waiting(problem)
        again_s = time.monotonic() + _ASK_AGAIN_S
        while (left_s := again_s - time.monotonic()) > 0:
            try:
                event = events.get(timeout=left_s)
            except queue.Empty:
                break
            if (raw := admit(event)) is not None:
                heard.keep(raw)
