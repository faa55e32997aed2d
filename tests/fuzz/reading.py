"""The content read from a file that may be damaged, and whether it is sound."""

import hashlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from filtering.motion import Odometry
from filtering.se3 import Poses
from sequences.frame import Camera, Frame
from tests.fuzz.mcap_damage import stated_images

NUM_IMAGES = 6


class UnsoundError(Exception):
    """A value that cannot be: a camera of negative focal length, a pose that is not finite."""


@dataclass(frozen=True)
class Reading:
    """The outcome of reading a file.

    Attributes:
        content: Digest of everything.
        items: How many images, poses or tensors.
        reported: How many of what were skipped, by reason, and notices.
    """

    content: bytes
    items: int
    reported: Mapping[str, int] = field(default_factory=dict)

    @property
    def images_skipped(self) -> int:
        """How many images were counted as skipped."""
        others = ("odometry time", "unusable odometry", "true pose time", "odometry from", "notice")
        return sum(count for reason, count in self.reported.items() if not reason.startswith(others))


@dataclass(frozen=True)
class Reader:
    """One way to read one kind of file.

    Attributes:
        make: Writes the sample into an empty folder and returns the path to read.
        read: Reads it.
        image_topic: Topic of a recording whose number of images is stated; None for other files.
        counts_images: Whether lost images must be counted.
    """

    make: Callable[[Path], Path]
    read: Callable[[Path], Reading]
    image_topic: str | None = None
    counts_images: bool = False

    def stated(self, path: Path) -> int | None:
        """How many images a recording states that it has; None where it does not."""
        if self.image_topic is None:
            return None
        files = [path] if path.is_file() else sorted(path.glob("*.mcap"))
        counts = [stated_images(file.read_bytes(), self.image_topic) for file in files]
        return sum(count or 0 for count in counts) or None


class Frames(Protocol):
    """A source of frames that counts those that it skips."""

    skipped: Counter[str]
    notices: Any

    def __iter__(self) -> Iterator[Frame]: ...


class Content:
    """A digest of values of any kind, which must be sound."""

    def __init__(self) -> None:
        self._hash = hashlib.blake2b(digest_size=16)

    def add(self, *values: Any) -> None:
        for value in values:
            if isinstance(value, Poses):
                self._pose(value)
            elif isinstance(value, Odometry):
                self._pose(value.previous_from_current)
                require(np.isfinite(value.covariance).all(), "covariance of odometry", value.covariance)
                self._hash.update(value.covariance.tobytes())
            elif isinstance(value, Camera):
                numbers = (value.fx, value.fy, value.cx, value.cy)
                require(bool(np.isfinite(numbers).all()) and value.fx > 0 and value.fy > 0, "camera", value)
                require(value.width > 0 and value.height > 0, "camera", value)
                self._hash.update(repr(value).encode())
            else:
                self._hash.update(value.tobytes() if isinstance(value, np.ndarray) else repr(value).encode())

    def _pose(self, poses: Poses) -> None:
        require(bool(poses.is_finite().all()), "pose", poses)
        rotation = poses.rotation
        skew = np.abs(np.swapaxes(rotation, -1, -2) @ rotation - np.eye(3)).max(initial=0.0)
        require(bool(skew < 1e-5), "rotation", poses)
        self._hash.update(rotation.tobytes() + poses.translation.tobytes())

    @property
    def digest(self) -> bytes:
        return self._hash.digest()


def require(sound: bool, what: str, value: Any) -> None:
    if not sound:
        raise UnsoundError(f"{what} {value}")


def read_frames(frames: Frames) -> Reading:
    """Read a sequence or a data set to its end."""
    content, number, before_ns = Content(), 0, None
    for frame in frames:
        require(before_ns is None or frame.time_ns > before_ns, "stamp", frame.time_ns)
        before_ns, number = frame.time_ns, number + 1
        content.add(frame.time_ns, frame.image, frame.odometry, frame.world_from_camera, frame.camera)
    return Reading(content.digest, number, frames.skipped + Counter(f"notice: {notice}" for notice in frames.notices))
