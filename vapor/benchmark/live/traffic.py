"""A robot that is played: a recorded walk there and back as a recording for `replay`, and what becomes of messages."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float64, Int64, UInt8

from filtering.errors import VaporTrackError
from filtering.se3 import Poses
from sequences.frame import Camera
from sequences.live.replay import ReplayOptions
from sequences.live.transport import Offer, Publish, Transport
from sequences.reader import SequenceReader
from sequences.recordings.bag import Bag
from sequences.recordings.messages import odometry_from_message
from sequences.recordings.source import TF_STATIC, RawMessage
from sequences.trajectories.interpolation import interpolate
from sequences.writer import SequenceWriter
from vapor.reporting.drawing import as_jpeg

MOST_IMAGES = 300
IMAGE, ODOMETRY = "/camera/image/compressed", "/odom"
"""Topics of a `SequenceWriter`."""
REPLAYED = ReplayOptions(loop=True, restamp=True, delay_s=0.0)
"""How `replay` plays a walk: over and over, with stamps of now."""
_JPEG_QUALITY = 92
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


class Timeline:
    """A walk that goes forwards, backwards, and so on, while time increases.

    Images that are asked for at a higher rate than they were recorded at are of a walk that is as much faster.

    Args:
        times_ns: Stamps of its images in the recording, three at least.
        rate: Images a second that are asked for.

    Attributes:
        speed: Seconds of the recording a second.
        duration_s: Of the way there and back.
        at_s: When the images on it are taken, after how many seconds of the way, (k,).
        numbers: Their numbers in the recording, (k,).
    """

    def __init__(self, times_ns: Int64[np.ndarray, " n"], rate: float) -> None:
        self._times_ns = times_ns
        self._span_ns = int(times_ns[-1] - times_ns[0])
        last = len(times_ns) - 1
        self.speed = max(rate * self._span_ns * 1e-9 / last, 1.0)
        self.duration_s = 2e-9 * self._span_ns / self.speed
        there_s = (times_ns - times_ns[0]) * 1e-9 / self.speed
        every_s = np.concatenate([there_s, self.duration_s - there_s[-2:0:-1]])
        numbers = np.concatenate([np.arange(last + 1), np.arange(last - 1, 0, -1)])
        # Of all images on the way there and back those nearest to evenly spaced times.
        number = max(round(self.duration_s * rate), 2)
        evenly_s = self.duration_s * np.arange(number) / number
        nearest = np.unique(np.abs(every_s - evenly_s[:, None]).argmin(axis=1))
        same = numbers[nearest] == np.roll(numbers[nearest], 1)  # just about a turn: the camera would seem frozen
        self.at_s, self.numbers = every_s[nearest[~same]], numbers[nearest[~same]]

    def recorded_ns(self, elapsed_s: Float64[np.ndarray, " m"]) -> Int64[np.ndarray, " m"]:
        """What time of the recording it is after so many seconds."""
        within_ns = np.rint(elapsed_s * self.speed * 1e9).astype(np.int64) % (2 * self._span_ns)
        return self._times_ns[0] + self._span_ns - abs(within_ns - self._span_ns)


def write_walk(
    path: Path,
    walk: Walk,
    rate: float,
    size: tuple[int, int] | None = None,
    *,
    odometry_hz: float = 200.0,
    from_s: float = 0.0,
) -> Timeline:
    """Write a walk there and back as a recording, which may be played over and over.

    Args:
        path: File to write.
        walk: The walk.
        rate: Images a second.
        size: Width and height of the images; None for that of the recording.
        odometry_hz: Messages of odometry a second, as nearly as a whole number fits into the way there and back.
        from_s: How far along its way it begins; odometry begins there at the identity.
    """
    size = size or (walk.camera.width, walk.camera.height)
    timeline = Timeline(walk.times_ns, rate)
    number = max(round(timeline.duration_s * odometry_hz), 1)
    odometry_s = timeline.duration_s * np.arange(number + 1) / number
    at_ns = timeline.recorded_ns(from_s + odometry_s)
    poses, _ = interpolate(walk.odometry_ns, walk.odom_from_base, at_ns, max_gap_s=np.inf)
    poses = poses[0].inverse() @ poses
    message = np.clip(np.searchsorted(walk.odometry_ns, at_ns), 1, len(walk.odometry_ns) - 1)
    recorded_s = (walk.odometry_ns[message] - walk.odometry_ns[message - 1]) * 1e-9
    # An increment errs with covariance twist · dt², and a part of it with that part of the covariance.
    finer = recorded_s * timeline.speed * number / timeline.duration_s
    covariances = walk.twist_covariances[message] * finer[:, None, None]
    covariances = np.where(np.isfinite(covariances), covariances, _UNMEASURED * np.eye(6))
    images_s = (timeline.at_s - from_s) % timeline.duration_s
    encoded = {image: _encoded(walk.images[image], size) for image in set(timeline.numbers.tolist())}
    events = [(due_s, ODOMETRY, k) for k, due_s in enumerate(odometry_s.tolist())]
    events += [(due_s, IMAGE, k) for due_s, k in zip(images_s.tolist(), timeline.numbers.tolist(), strict=True)]
    with SequenceWriter(path, camera=walk.camera.scaled(*size), base_from_camera=walk.base_from_camera) as writer:
        for due_s, topic, k in sorted(events):
            time_ns = round(due_s * 1e9)
            if topic == IMAGE:
                writer.write_encoded_image(time_ns, encoded[k], "jpeg")
            else:
                writer.write_odometry(time_ns, poses[k], covariances[k])
    return timeline


def _encoded(image: UInt8[np.ndarray, "height width 3"], size: tuple[int, int]) -> bytes:
    shrinks = size[0] < image.shape[1]
    resized = cv2.resize(image, size, interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)
    return as_jpeg(np.asarray(resized, np.uint8), _JPEG_QUALITY)


# --- messages ---------------------------------------------------------------------------------------


class AlteringTransport:
    """A transport that publishes what becomes of the messages of topics with headers.

    Args:
        transport: The transport.
        alter: The bytes to publish in place of a topic's; None for none.
    """

    def __init__(self, transport: Transport, alter: Callable[[str, bytes], bytes | None]) -> None:
        self._transport, self._alter = transport, alter

    @property
    def name(self) -> str:
        """The transport's name."""
        return self._transport.name

    def offers(self) -> list[Offer]:
        """As the transport's."""
        return self._transport.offers()

    def subscribe(self, offer: Offer, deliver: Callable[[RawMessage], None]) -> None:
        """As the transport's."""
        self._transport.subscribe(offer, deliver)

    def advertise(self, topic: str, message_type: str, *, latched: bool = False) -> Publish:
        """As the transport's, but for the messages."""
        publish = self._transport.advertise(topic, message_type, latched=latched)
        if topic == TF_STATIC:
            return publish

        def publish_altered(data: bytes) -> None:
            if (altered := self._alter(topic, data)) is not None:
                publish(altered)

        return publish_altered

    def close(self) -> None:
        """As the transport's."""
        self._transport.close()


def with_stamp(data: bytes, time_ns: int) -> bytes:
    """A message that begins with a header, with this stamp."""
    return b"".join((data[:4], _STAMP.pack(*divmod(time_ns, 1_000_000_000)), memoryview(data)[12:]))


def stamp_of(data: bytes) -> int:
    """Stamp of a message that begins with a header, little-endian as this package writes them, nanoseconds."""
    sec, nanosec = _STAMP.unpack_from(data, 4)
    return sec * 1_000_000_000 + nanosec
