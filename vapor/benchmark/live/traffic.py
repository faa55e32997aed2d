"""A robot that is played: the images, odometry and intrinsics of a recorded walk as ROS 2 topics, for any duration."""

from __future__ import annotations

import heapq
import struct
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple, overload

import cv2
import numpy as np
from jaxtyping import Float64, Int64, UInt8

from filtering.errors import VaporTrackError
from filtering.se3 import Poses
from sequences.frame import Camera
from sequences.live.transport import Transport
from sequences.reader import SequenceReader
from sequences.recordings.bag import Bag
from sequences.recordings.mcap_writer import (
    BASE_FRAME,
    CAMERA_FRAME,
    ODOM_FRAME,
    ros_header,
    ros_poses,
    ros_transform,
)
from sequences.recordings.message_definitions import encoder
from sequences.recordings.messages import odometry_from_message
from sequences.recordings.source import TF_STATIC
from sequences.trajectories.interpolation import interpolate

MOST_IMAGES = 300
IMAGE, ODOMETRY, CAMERA_INFO = "/camera/image/compressed", "/odom", "/camera/camera_info"
"""Topics; compressed images are on /camera/image/compressed."""
_JPEG_QUALITY = 92
_LONGEST_SLEEP_S = 0.05
_UNMEASURED = 1e6
_STAMP = struct.Struct("<iI")  # behind the four bytes that every message begins with, where it begins with a header


@dataclass(frozen=True)
class Walk:
    """A recorded walk, decoded.

    Attributes:
        times_ns: Stamps of the images (n,).
        images: RGB; none equals the one before.
        world_from_camera: True poses of the images, batch (n,); None where the recording has not all of them.
        camera: Intrinsics of the images.
        base_from_camera: Extrinsics, one pose.
        odometry_ns: Stamps of the odometry (m,).
        odom_from_base: Batch (m,).
        twist_covariances: Of the velocity (v, ω) in the base frame; infinite on the diagonal where it is not measured.
    """

    times_ns: Int64[np.ndarray, " n"]
    images: list[UInt8[np.ndarray, "height width 3"]]
    world_from_camera: Poses | None
    camera: Camera
    base_from_camera: Poses
    odometry_ns: Int64[np.ndarray, " m"]
    odom_from_base: Poses
    twist_covariances: Float64[np.ndarray, "m 6 6"]

    @property
    def rate(self) -> float:
        """Images a second, on average."""
        return (len(self.times_ns) - 1) * 1e9 / float(self.times_ns[-1] - self.times_ns[0])


def read_walk(recording: Path) -> Walk:
    """The first images of a recording, at most 300, and the odometry along them.

    Raises:
        VaporTrackError: the recording cannot be read, has fewer than three images, no intrinsics or no topic of
            odometry.
    """
    reader = SequenceReader(recording)
    frames = []
    for frame in islice(reader, MOST_IMAGES):
        if not frames or not np.array_equal(frame.image, frames[-1].image):  # else the camera would seem frozen
            frames.append(frame)
    if len(frames) < 3:
        raise VaporTrackError(f"{recording}: {len(frames)} different images with odometry, expected three at least")
    topic, extrinsics = reader.resolved["odometry_topic"], reader.base_from_camera
    if reader.camera is None or extrinsics is None or not topic:
        raise VaporTrackError(f"{recording}: no intrinsics or no topic of odometry, expected both")
    samples = {s.time_ns: s for raw in Bag(recording).messages([topic]) for s in [odometry_from_message(raw.decode())]}
    samples = [samples[time_ns] for time_ns in sorted(samples)]
    truth = [frame.world_from_camera for frame in frames if frame.world_from_camera is not None]
    return Walk(
        np.array([frame.time_ns for frame in frames], np.int64),
        [frame.image for frame in frames],
        Poses.stack(truth) if len(truth) == len(frames) else None,
        reader.camera,
        extrinsics,
        np.array([sample.time_ns for sample in samples], np.int64),
        Poses.stack([sample.odom_from_base for sample in samples]),
        np.stack([sample.twist_covariance for sample in samples]),
    )


# --- schedule ----------------------------------------------------------------------------


@overload
def folded(position: int, end: int) -> int: ...
@overload
def folded(position: Int64[np.ndarray, " n"], end: int) -> Int64[np.ndarray, " n"]: ...


def folded(position: int | Int64[np.ndarray, " n"], end: int) -> int | Int64[np.ndarray, " n"]:
    """Where one is that goes from 0 to an end, back to 0, and so on, after so long a way."""
    within = position % (2 * end)
    return end - abs(within - end)


def image_positions(number: int, step: float) -> Iterator[int]:
    """Way along numbered images, forwards, backwards and so on (see `folded`), that skips some.

    Args:
        number: How many images there are, three at least.
        step: From one to the next on average, 1 at least.

    Yields:
        Ways, increasing; no two neighbours are the same image.
    """
    before, k = -1, 0
    while True:
        position = max(round(k * step), before + 1)
        if before >= 0 and folded(position, number - 1) == folded(before, number - 1):  # just about a turn
            position = position - 1 if position - 1 > before else position + 1
        yield position
        before, k = position, k + 1


class Timeline:
    """A walk that goes forwards, backwards, and so on, while time increases.

    Images that are asked for at a higher rate than they were recorded at are of a walk that is as much faster.

    Args:
        times_ns: Stamps of its images in the recording, three at least.
        rate: Images a second that are asked for.

    Attributes:
        speed: Seconds of the recording a second.
        duration_s: Of the way there and back.
    """

    def __init__(self, times_ns: Int64[np.ndarray, " n"], rate: float) -> None:
        self._times_ns = times_ns
        self._span_ns = int(times_ns[-1] - times_ns[0])
        recorded = (len(times_ns) - 1) * 1e9 / self._span_ns
        self.speed = max(rate / recorded, 1.0)
        self.duration_s = 2e-9 * self._span_ns / self.speed
        self._step = recorded * self.speed / rate

    def recorded_ns(self, elapsed_s: Float64[np.ndarray, " m"]) -> Int64[np.ndarray, " m"]:
        """What time of the recording it is after so many seconds."""
        return self._times_ns[0] + folded(np.rint(elapsed_s * self.speed * 1e9).astype(np.int64), self._span_ns)

    def images(self) -> Iterator[tuple[float, int]]:
        """Images without end: after how many seconds each is taken, at exactly that point of the walk; its number."""
        last = len(self._times_ns) - 1
        for position in image_positions(last + 1, self._step):
            rounds, within = divmod(position, 2 * last)
            image = folded(position, last)
            there_ns = int(self._times_ns[image] - self._times_ns[0])
            way_ns = 2 * self._span_ns * rounds + (there_ns if within <= last else 2 * self._span_ns - there_ns)
            yield way_ns * 1e-9 / self.speed, image


# --- messages ---------------------------------------------------------------------------------------


class Outgoing(NamedTuple):
    """A message to publish.

    Attributes:
        due_s: When it is of, by seconds since the beginning.
        topic: Where.
        data: Its bytes, whose stamp is to be set.
    """

    due_s: float
    topic: str
    data: bytes


class Traffic:
    """All messages of a robot whose camera has some rate and size, encoded before.

    Args:
        walk: Its path.
        rate: Images a second.
        size: Width and height of the images; None for that of the recording.
        odometry_hz: Messages of odometry a second; as nearly as a whole number fits into the way there and back.

    Attributes:
        types: Type of the messages by topic.
        static: Bytes of the one message on /tf_static.
        timeline: When the images are of.
    """

    def __init__(
        self,
        walk: Walk,
        rate: float,
        size: tuple[int, int] | None = None,
        *,
        odometry_hz: float = 200.0,
    ) -> None:
        size = size or (walk.camera.width, walk.camera.height)
        self.timeline = Timeline(walk.times_ns, rate)
        self.types = {
            IMAGE: "sensor_msgs/CompressedImage",
            CAMERA_INFO: "sensor_msgs/CameraInfo",
            ODOMETRY: "nav_msgs/Odometry",
            TF_STATIC: "tf2_msgs/TFMessage",
        }
        transform = ros_transform(0, BASE_FRAME, CAMERA_FRAME, ros_poses(walk.base_from_camera))
        self.static = encoder("tf2_msgs/TFMessage")({"transforms": [transform]})
        self._info = encoder("sensor_msgs/CameraInfo")(_info(walk.camera.scaled(*size)))
        self._images = [encoder("sensor_msgs/CompressedImage")(_image(image, size)) for image in walk.images]
        number = max(round(self.timeline.duration_s * odometry_hz), 1)
        self._odometry_s = self.timeline.duration_s * np.arange(number) / number
        self._odometry = self._encode_odometry(walk)

    def messages(self) -> Iterator[Outgoing]:
        """All but the static one, without end, in order of time."""
        return heapq.merge(self._camera(), self._base(), key=lambda outgoing: outgoing.due_s)

    def _camera(self) -> Iterator[Outgoing]:
        for due_s, number in self.timeline.images():
            yield Outgoing(due_s, CAMERA_INFO, self._info)
            yield Outgoing(due_s, IMAGE, self._images[number])

    def _base(self) -> Iterator[Outgoing]:
        begin_s = 0.0
        while True:
            for due_s, data in zip(self._odometry_s, self._odometry, strict=True):
                yield Outgoing(begin_s + float(due_s), ODOMETRY, data)
            begin_s += self.timeline.duration_s

    def _encode_odometry(self, walk: Walk) -> list[bytes]:
        """Odometry of the path there and back; its stated noise along the same path is equal."""
        at_ns = self.timeline.recorded_ns(self._odometry_s)
        poses, _ = interpolate(walk.odometry_ns, walk.odom_from_base, at_ns, max_gap_s=np.inf)
        message = np.clip(np.searchsorted(walk.odometry_ns, at_ns), 1, len(walk.odometry_ns) - 1)
        recorded_s = (walk.odometry_ns[message] - walk.odometry_ns[message - 1]) * 1e-9
        # An increment errs with covariance twist · dt², and a part of it with that part of the covariance.
        interval_s = self.timeline.duration_s / len(at_ns)
        covariances = walk.twist_covariances[message] * (recorded_s * self.timeline.speed / interval_s)[:, None, None]
        covariances = np.where(np.isfinite(covariances), covariances, _UNMEASURED * np.eye(6))
        return [
            encoder("nav_msgs/Odometry")(
                {
                    "header": ros_header(0, ODOM_FRAME),
                    "child_frame_id": BASE_FRAME,
                    "pose": {"pose": pose},
                    "twist": {"covariance": covariance},
                }
            )
            for pose, covariance in zip(ros_poses(poses), covariances, strict=True)
        ]


def _image(image: UInt8[np.ndarray, "height width 3"], size: tuple[int, int]) -> dict[str, Any]:
    shrinks = size[0] < image.shape[1]
    resized = cv2.resize(image, size, interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)
    bgr = cv2.cvtColor(resized, cv2.COLOR_RGB2BGR)
    data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1].tobytes()
    return {"header": ros_header(0, CAMERA_FRAME), "format": "jpeg", "data": data}


def _info(c: Camera) -> dict[str, Any]:
    return {
        "header": ros_header(0, CAMERA_FRAME),
        "height": c.height,
        "width": c.width,
        "distortion_model": "plumb_bob",
        "d": [0.0] * 5,
        "k": [c.fx, 0.0, c.cx, 0.0, c.fy, c.cy, 0.0, 0.0, 1.0],
        "r": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        "p": [c.fx, 0.0, c.cx, 0.0, 0.0, c.fy, c.cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    }


def with_stamp(data: bytes, time_ns: int) -> bytes:
    """A message that begins with a header, with this stamp."""
    return b"".join((data[:4], _STAMP.pack(*divmod(time_ns, 1_000_000_000)), memoryview(data)[12:]))


def stamp_of(data: bytes) -> int:
    """Stamp of a message that begins with a header, little-endian as this package writes them, nanoseconds."""
    sec, nanosec = _STAMP.unpack_from(data, 4)
    return sec * 1_000_000_000 + nanosec


# --- playing ----------------------------------------------------------------------------------------


class Sent(NamedTuple):
    """A message that was published.

    Attributes:
        topic: Where.
        stamp_ns: Its stamp.
        at_ns: When, just before, by the monotonic clock.
        late_s: How late that was.
    """

    topic: str
    stamp_ns: int
    at_ns: int
    late_s: float


Altered = tuple[bytes, int] | None
"""Bytes of a message, and by how many nanoseconds its stamp is wrong; None where it is not published."""


def play(
    transport: Transport,
    traffic: Traffic,
    *,
    from_s: float = 0.0,
    alter: Callable[[Outgoing], Altered] = lambda outgoing: (outgoing.data, 0),
) -> Iterator[Sent]:
    """Publish the messages of a robot in real time without end, stamped with the times at which they are due.

    A message that is late is published at once.

    Args:
        from_s: How far along its way it begins.
        alter: What becomes of a message when it is due.
    """
    publish = {name: transport.advertise(name, kind, latched=name == TF_STATIC) for name, kind in traffic.types.items()}
    publish[TF_STATIC](traffic.static)
    begin_s, begin_ns = time.monotonic() - from_s, time.time_ns() - round(from_s * 1e9)
    for outgoing in traffic.messages():
        if outgoing.due_s < from_s:
            continue
        due_s = begin_s + outgoing.due_s
        while (left_s := due_s - time.monotonic()) > 0:
            time.sleep(min(left_s, _LONGEST_SLEEP_S))
        if (altered := alter(outgoing)) is None:
            continue
        stamp_ns = begin_ns + round(outgoing.due_s * 1e9) + altered[1]
        data = with_stamp(altered[0], stamp_ns)
        at_ns = time.monotonic_ns()
        publish[outgoing.topic](data)
        yield Sent(outgoing.topic, stamp_ns, at_ns, at_ns * 1e-9 - due_s)
