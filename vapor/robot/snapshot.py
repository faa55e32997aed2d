"""What is believed at one moment, and the image that it comes from, as an MCAP file."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import cv2

from sequences.frame import Frame
from sequences.recordings.mcap_writer import CAMERA_FRAME, MessageWriter, ros_header
from sequences.recordings.source import RawMessage

_IMAGE = "sensor_msgs/CompressedImage"


class _Snapshot(MessageWriter):
    def __enter__(self) -> _Snapshot:
        self._open()
        return self

    def write(self, frame: Frame, believed: Iterable[RawMessage]) -> None:
        messages = list(believed)
        now_ns = max((raw.log_time_ns for raw in messages), default=frame.time_ns)
        _, png = cv2.imencode(".png", cv2.cvtColor(frame.image, cv2.COLOR_RGB2BGR))
        header = ros_header(frame.time_ns, CAMERA_FRAME)
        self._write("/image", _IMAGE, {"header": header, "format": "png", "data": png.tobytes()}, now_ns)
        for raw in messages:
            self._channels.write(raw)


def write_snapshot(folder: Path, frame: Frame, believed: Iterable[RawMessage]) -> Path:
    """Write the image, undistorted as the network saw it, and the messages that were published of it.

    Raises:
        SequenceError, OSError: the file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"snapshot-{frame.time_ns}.mcap"
    with _Snapshot(path) as snapshot:
        snapshot.write(frame, believed)
    return path
