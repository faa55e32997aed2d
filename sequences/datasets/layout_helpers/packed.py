"""Images that are no files of their own: members of a zip archive, frames of a video."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8

from filtering.errors import quoted
from sequences.errors import SequenceError
from sequences.images.headers import require_pixels

os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # read at the first video; errors are reported here

VIDEO_SUFFIXES = (".mp4", ".mov", ".m4v", ".mkv", ".avi", ".webm")
"""Of video files."""

_MAX_MEMBER = 64 << 20  # bytes, unpacked
_JPEG_QUALITY = 95  # of frames of a video, which were compressed more than that


@dataclass(frozen=True)
class PackedImage:
    """One image in a container, in place of its path.

    Attributes:
        path: Of the container.
        key: Which image of it: name of a member, number of a frame.
        container: Its reader.
    """

    path: Path
    key: str
    container: Archive | VideoFile = field(compare=False)

    @property
    def name(self) -> str:
        """Name of the container and of the image in it."""
        return f"{self.path.name}:{self.key}"

    def __str__(self) -> str:
        return f"{self.path}:{self.key}"

    def read_bytes(self) -> bytes:
        """Bytes of a JPEG or PNG. Raises SequenceError where it cannot be read."""
        return self.container.read(self.key)

    def resolve(self) -> PackedImage:
        """The same with the path of the container resolved: equal where it is the same image."""
        return replace(self, path=self.path.resolve())


ImageFile = Path | PackedImage


class Archive:
    """A zip archive.

    Attributes:
        path: Where it lies.
        names: Names of its members.
    """

    def __init__(self, path: Path) -> None:
        """Open an archive. Raises SequenceError where it is none."""
        self.path = path
        try:
            self._file = zipfile.ZipFile(path)
        except (OSError, zipfile.BadZipFile, NotImplementedError, ValueError) as error:  # of version, and of names
            raise SequenceError(f"{path}: cannot be read as a zip archive: {error}; expected a complete one") from error
        self._sizes = {member.filename: member.file_size for member in self._file.infolist()}
        self.names = frozenset(self._sizes)

    def read(self, key: str, /) -> bytes:
        """Bytes of a member. Raises SequenceError where it is missing, damaged, or too large for what it may hold."""
        if (size := self._sizes.get(key, 0)) > _MAX_MEMBER:
            raise SequenceError(f"{self.path}: {quoted(key)} has {size:,} bytes, expected at most {_MAX_MEMBER:,}")
        try:
            return self._file.read(key)
        except Exception as error:  # the library lets zlib, key and runtime errors of damaged archives through
            raise SequenceError(f"{self.path}: member {quoted(key)} cannot be read: {error}") from error


class VideoFile:
    """Frames of a video by their numbers from 0 on; one after the other is fast, and all are as they were stored.

    Attributes:
        path: Where it lies.
        num_frames: As the file states it; None where it does not.
        width: Of its frames, pixels.
        height: Of its frames, pixels.
    """

    def __init__(self, path: Path, *, upright: bool = False) -> None:
        """Open a video, whose frames are `upright` where they are turned by its metadata, as a player shows them.

        Raises SequenceError where it cannot be read.
        """
        self.path, self._upright = path, upright
        self._open()
        self.width = int(self._capture.get(cv2.CAP_PROP_FRAME_WIDTH))
        self.height = int(self._capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
        require_pixels(self.width, self.height, str(path))
        stated = self._capture.get(cv2.CAP_PROP_FRAME_COUNT)
        self.num_frames = int(stated) if 0 < stated < 1e9 else None

    def _open(self) -> None:
        level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
        try:
            # FFmpeg takes what precedes a colon in a relative path for a protocol.
            self._capture = cv2.VideoCapture(os.path.abspath(self.path), cv2.CAP_FFMPEG)
        finally:
            cv2.utils.logging.setLogLevel(level)
        # Stated intrinsics are of the pixels as they are stored, however the phone was held.
        self._capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, int(self._upright))
        self._next = 0
        if not self._capture.isOpened():
            if not self.path.is_file():
                raise SequenceError(f"{self.path}: no such file, expected a video")
            raise SequenceError(f"{self.path}: cannot be opened as a video, expected a complete file (H.264 or HEVC)")

    def frames(self) -> Iterator[tuple[int, Callable[[], UInt8[np.ndarray, "height width 3"]]]]:
        """All frames in order: the time stamp, nanoseconds since the beginning, and what gives the frame, RGB.

        A damaged video ends with the last frame before the damage. Raises SequenceError where there is no frame.
        """
        self._open()
        while self._capture.grab():
            self._next += 1
            yield round(1e6 * self._capture.get(cv2.CAP_PROP_POS_MSEC)), self._retrieved
        if not self._next:
            raise SequenceError(f"{self.path}: no frame can be read, expected a video of H.264 or HEVC")

    def _retrieved(self) -> UInt8[np.ndarray, "height width 3"]:
        """The frame that was read last. Raises SequenceError where it is damaged."""
        found, image = self._capture.retrieve()
        if not found or image is None:
            raise SequenceError(f"{self.path}: frame {self._next - 1} cannot be decoded, expected a complete file")
        return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)

    def frame(self, number: int) -> PackedImage:
        """The image of a frame."""
        return PackedImage(self.path, str(number), self)

    def read(self, key: str, /) -> bytes:
        """A frame as JPEG. Raises SequenceError where the video has no such frame, or it is damaged."""
        number = int(key)
        if number < self._next:
            self._open()
        while self._next < number and self._capture.grab():  # exact, unlike seeking
            self._next += 1
        found, image = self._capture.read() if self._next == number else (False, None)
        if not found or image is None:
            raise SequenceError(f"{self.path}: frame {number} cannot be read, {self._next} before it could")
        self._next += 1
        encoded, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
        if not encoded:
            raise SequenceError(f"{self.path}: frame {number} cannot be encoded as an image")
        return data.tobytes()
