"""Joining a running system."""

from __future__ import annotations

from sequences.errors import SequenceError
from sequences.live.options import DdsOptions
from sequences.live.transport import Transport


def join(options: DdsOptions | None = None) -> Transport:
    """Become a participant of a ROS 2 system.

    Raises:
        SequenceError: cyclonedds is not installed.
        VaporTrackError: the domain cannot be joined.
    """
    try:
        from sequences.live.dds import DdsTransport
    except ImportError as error:
        raise SequenceError(
            "live topics need cyclonedds, expected it installed: pip install vapor-track[live]"
        ) from error
    return DdsTransport(options)
