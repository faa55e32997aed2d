"""A recorded sequence -> frames: images, the odometry between them and, where recorded, the true poses."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np
from jaxtyping import UInt8

from filtering.errors import VaporTrackError, require_within
from filtering.motion import MotionNoise
from filtering.se3 import Poses
from sequences.bag import Bag, RawMessage, Topic
from sequences.errors import SequenceError
from sequences.frame import Camera, Frame
from sequences.message_definitions import decoder
from sequences.messages import (
    camera_from_message,
    decode_compressed_image,
    decode_image,
    frame_name,
    odometry_from_message,
    pose_from_message,
    stamp_ns,
    transforms_from_message,
)
from sequences.pairing import PoseWindow
from sequences.transforms import TransformTree

OdometryUse = Literal["required", "optional", "unread"]

METADATA_NAME = "vapor-track"  # of the record in which a file says where its odometry comes from
MAX_ODOMETRY_GAP_S = 0.5
MAX_TRUE_POSE_GAP_S = 0.1
_MAX_WAITING = 64  # images held, still encoded, until odometry and true poses reach them

_MAX_DURATION_S = 1e9  # of a recording; NaN and infinity are none
_MAX_LATENESS_S = 10.0  # how much later than its stamp a message may be logged, and how far clocks may jump ahead

_ImageDecoder = Callable[[SimpleNamespace], UInt8[np.ndarray, "height width 3"]]
_IMAGE_DECODERS: dict[str, _ImageDecoder] = {
    "sensor_msgs/Image": decode_image,
    "sensor_msgs/CompressedImage": decode_compressed_image,
}


@dataclass(frozen=True)
class SequenceOptions:
    """What to read of a sequence. Topics are found by their type where there is only one."""

    image_topic: str | None = None
    """Topic of the images, sensor_msgs/Image or CompressedImage."""
    odometry_topic: str | None = None
    """Topic of the odometry, nav_msgs/Odometry."""
    ground_truth_topic: str | None = None
    """Topic of the camera's true poses, geometry_msgs/PoseStamped; '' for none."""
    camera_info_topic: str | None = None
    """Topic of the intrinsics, sensor_msgs/CameraInfo; '' for none. Default: the one beside the image topic."""
    camera_frame: str | None = None
    """Frame of the camera, for tf. Default: the frame in the header of the images."""
    base_from_camera: tuple[float, float, float, float, float, float, float] | None = None
    """Pose of the camera on the robot, tx ty tz qx qy qz qw, instead of tf."""
    motion_noise: MotionNoise = field(default_factory=MotionNoise)
    """Noise of odometry whose messages carry no covariance (zeros, or -1 first), and of the axes that they state a
    variance of 1000 or more for, a placeholder for what is not measured."""
    start_s: float = 0.0
    """Seconds after the first image at which to begin."""
    duration_s: float | None = None
    """Seconds to read. Default: to the end."""

    def __post_init__(self) -> None:
        require_within(self, start_s=(0.0, _MAX_DURATION_S))
        if self.duration_s is not None:
            require_within(self, duration_s=(0.0, _MAX_DURATION_S))
        for name in ("image_topic", "odometry_topic"):
            if getattr(self, name) == "":
                raise SequenceError(f"{name} is '', expected the name of a topic: it cannot be left out")
        if self.base_from_camera is not None:
            try:
                _pose_of_numbers(self.base_from_camera)
            except VaporTrackError as error:
                raise SequenceError(f"--base-from-camera: {error}; expected tx ty tz qx qy qz qw") from error


class SequenceReader:
    """Frames of an MCAP file or rosbag2 folder, read as a stream; every iteration reads it anew.

    Attributes:
        path: The file or folder.
        skipped: How many images and messages of the latest iteration were left out, by reason.
        camera: Intrinsics, None where the file has none.
        base_from_camera: Extrinsics, one pose; None where odometry is not read.
        num_images: Images in the file, all of it: for progress.
        odometry_description: What the file says of where its odometry comes from; None where it says nothing.
    """

    def __init__(
        self, path: Path | str, options: SequenceOptions | None = None, *, odometry: OdometryUse = "required"
    ) -> None:
        """Open a sequence, find its topics and extrinsics.

        Args:
            path: MCAP file or rosbag2 folder.
            options: What to read; None for all of it, as found.
            odometry: "required" reads it, and skips the images that it does not cover. "optional" gives images it where
                it can be found, without a choice to make, and skips none for lack of it. "unread" leaves it alone.

        Raises:
            SequenceError: the file is damaged, a topic is missing or ambiguous, or no transform leads from the
                odometry's child frame to the camera.
        """
        self.path = Path(path)
        self.skipped: Counter[str] = Counter()
        self._options = options or SequenceOptions()
        self._bag = Bag(self.path)
        self._topics = _Topics(self._bag, self._options, odometry)
        self.num_images = self._topics.image.num_messages
        self.camera = _read_camera(self._bag, self._topics.camera_info)
        self.base_from_camera: Poses | None = None
        if self._topics.odometry is not None:
            try:
                self.base_from_camera = _read_extrinsics(
                    self._bag, self._options, self._topics.image, self._topics.odometry
                )
            except SequenceError:
                if odometry == "required":
                    raise
                self._topics.odometry = None
        self.odometry_description = self._bag.metadata.get(METADATA_NAME, {}).get("odometry")

    @property
    def resolved(self) -> dict[str, Any]:
        """The options that say what to read, as they were found: topics, and the extrinsics; '' and None for none."""
        t = self._topics
        topics = {"image": t.image, "odometry": t.odometry, "ground_truth": t.truth, "camera_info": t.camera_info}
        extrinsics = self.base_from_camera
        return {f"{role}_topic": topic.name if topic else "" for role, topic in topics.items()} | {
            "base_from_camera": [*extrinsics.translation.tolist(), *extrinsics.as_quat_xyzw().tolist()]
            if extrinsics is not None
            else None
        }

    def __iter__(self) -> Iterator[Frame]:
        """Frames in order of time. Raises SequenceError where the file is damaged, or no image is left."""
        pairing = _Pairing(self.path, self._topics, self._options, self.base_from_camera, self.camera)
        self.skipped = pairing.skipped
        num_frames = 0
        for raw in self._bag.messages(self._topics.streamed):
            if pairing.is_over(raw):
                break
            pairing.take(raw, _decode(self._bag, raw, tolerate=self._topics.may_be_damaged(raw.topic)))
            for frame in pairing.ready_frames():
                num_frames += 1
                yield frame
        for frame in pairing.ready_frames(at_end=True):
            num_frames += 1
            yield frame
        if num_frames == 0:
            found = ", ".join(f"{count} × {reason}" for reason, count in self.skipped.items()) or "nothing was skipped"
            raise SequenceError(
                f"{self.path}: no image left of {self.num_images} on {self._topics.image.name}: {found}"
                f"{pairing.first_problem}; expected at least one that can be used"
            )


class _Pairing:
    """The state of one iteration: images wait, still encoded, until odometry and true poses have come as far."""

    def __init__(
        self,
        path: Path,
        topics: _Topics,
        options: SequenceOptions,
        base_from_camera: Poses | None,
        camera: Camera | None,
    ):
        self._path = path
        self.skipped: Counter[str] = Counter()
        self.first_problem = ""
        self._topics = topics
        self._options = options
        self._base_from_camera = base_from_camera
        self._camera = camera
        self._decode_image = _IMAGE_DECODERS[topics.image.type]
        self._odometry = PoseWindow(MAX_ODOMETRY_GAP_S)
        self._truth = PoseWindow(MAX_TRUE_POSE_GAP_S)
        self._waiting: deque[tuple[int, SimpleNamespace]] = deque()
        self._begin: tuple[int, int] | None = None  # stamp and log time of the first image
        self._previous_ns: int | None = None  # stamp of the last frame
        self._previous_covered = False  # by odometry
        self._ahead_ns: dict[str, int] = {}  # topic -> stamp less log time of its last usual message

    def is_over(self, raw: RawMessage) -> bool:
        """Whether a message lies so far behind the stretch asked for that nothing of it can come any more."""
        if self._options.duration_s is None or self._begin is None:
            return False
        since_s = (raw.log_time_ns - self._begin[1]) * 1e-9
        return since_s > self._options.start_s + self._options.duration_s + _MAX_LATENESS_S

    def take(self, raw: RawMessage, message: SimpleNamespace | None) -> None:
        """Take one message in, of whichever topic; None for bytes that are no message."""
        if message is None:
            is_image = raw.topic == self._topics.image.name
            self._skip("undecodable image" if is_image else "unusable odometry", raw.log_time_ns)
            return
        time_ns = stamp_ns(message.header)
        if self._jumps_ahead(raw, time_ns):
            self._skip("time stamp far ahead", raw.log_time_ns)
            return
        if raw.topic == self._topics.image.name:
            self._begin = self._begin or (time_ns, raw.log_time_ns)
            since_s = (time_ns - self._begin[0]) * 1e-9 - self._options.start_s
            if since_s >= 0 and (self._options.duration_s is None or since_s <= self._options.duration_s):
                self._waiting.append((time_ns, message))
            return
        is_odometry = self._topics.odometry is not None and raw.topic == self._topics.odometry.name
        window, what = (self._odometry, "odometry") if is_odometry else (self._truth, "true pose")
        try:
            if is_odometry:
                sample = odometry_from_message(message)
                pose, covariance = sample.odom_from_base, sample.twist_covariance
            else:
                pose, covariance = pose_from_message(message.pose), None
        except VaporTrackError as error:
            if is_odometry and not self._topics.odometry_required:
                self._skip("unusable odometry", time_ns, error)
                return
            raise SequenceError(f"{self._path}: {raw.topic} at {time_ns} ns: {what}: {error}") from error
        if not window.append(time_ns, pose, covariance):
            self._skip(f"{what} time stamp not increasing", time_ns)
        if self._previous_ns is None and not self._waiting:
            # Before the first image there is nothing to remember but what a late image may still ask for.
            window.forget_before(time_ns - int(_MAX_LATENESS_S * 1e9))

    def _jumps_ahead(self, raw: RawMessage, time_ns: int) -> bool:
        """Whether a stamp ran ahead of its log time, by what is usual on its topic: all after it would seem late."""
        ahead_ns = time_ns - raw.log_time_ns
        drift_ns = ahead_ns - self._ahead_ns.setdefault(raw.topic, ahead_ns)
        if abs(drift_ns) <= _MAX_LATENESS_S * 1e9:
            self._ahead_ns[raw.topic] = ahead_ns  # clocks may drift apart slowly
        return drift_ns > _MAX_LATENESS_S * 1e9

    def ready_frames(self, *, at_end: bool = False) -> Iterator[Frame]:
        """Frames of the images that need to wait no longer."""
        while self._waiting and (at_end or len(self._waiting) > _MAX_WAITING or self._is_reached(self._waiting[0][0])):
            frame = self._frame(*self._waiting.popleft())
            if frame is not None:
                yield frame

    def _is_reached(self, time_ns: int) -> bool:
        return (self._topics.odometry is None or self._odometry.reaches(time_ns)) and (
            self._topics.truth is None or self._truth.reaches(time_ns)
        )

    def _frame(self, time_ns: int, message: SimpleNamespace) -> Frame | None:
        """The frame of an image; None, and a count of why, where it is skipped."""
        previous_ns = self._previous_ns
        if previous_ns is not None and time_ns <= previous_ns:
            return self._skip("time stamp not increasing", time_ns)
        covered = self._topics.odometry is not None and self._odometry.at(time_ns) is not None
        if self._topics.odometry_required and not covered:
            return self._skip("odometry does not cover", time_ns)
        try:
            image = self._decode_image(message)
        except SequenceError as error:
            return self._skip("undecodable image", time_ns, error)
        odometry = None
        if self._base_from_camera is not None and previous_ns is not None and covered and self._previous_covered:
            odometry = self._odometry.odometry_between(
                previous_ns,
                time_ns,
                base_from_camera=self._base_from_camera,
                motion_noise=self._options.motion_noise,
            )
        truth = self._truth.at(time_ns)
        self._odometry.forget_before(time_ns)
        self._truth.forget_before(time_ns)
        self._previous_ns, self._previous_covered = time_ns, covered
        return Frame(time_ns, image, odometry, truth, self._camera)

    def _skip(self, reason: str, time_ns: int, error: Exception | None = None) -> None:
        if not self.skipped:
            self.first_problem = f" (first at {time_ns} ns{f': {error}' if error else ''})"
        self.skipped[reason] += 1


class _Topics:
    """Which topic plays which role: the one named by an option, or the only one of its types."""

    def __init__(self, bag: Bag, options: SequenceOptions, odometry: OdometryUse):
        image = _choose(bag, "image", tuple(_IMAGE_DECODERS), options.image_topic, required=True)
        assert image is not None
        self.image = image
        self.odometry: Topic | None = None
        self.odometry_required = odometry == "required"
        if odometry != "unread":
            try:
                self.odometry = _choose(bag, "odometry", ("nav_msgs/Odometry",), options.odometry_topic, required=True)
            except SequenceError:
                if self.odometry_required:
                    raise
        self.truth = _choose(bag, "ground-truth", ("geometry_msgs/PoseStamped",), options.ground_truth_topic)
        info_name = options.camera_info_topic
        if info_name is None:
            # By the habit of ROS, the intrinsics lie beside the image topic.
            beside = image.name.removesuffix("/compressed").rsplit("/", 1)[0] + "/camera_info"
            info_name = beside if beside in bag.topics else None
        self.camera_info = _choose(bag, "camera-info", ("sensor_msgs/CameraInfo",), info_name)

    def may_be_damaged(self, name: str) -> bool:
        """Whether messages of a topic that cannot be decoded are left out, rather than an error."""
        return name == self.image.name or (
            self.odometry is not None and name == self.odometry.name and not self.odometry_required
        )

    @property
    def streamed(self) -> list[str]:
        """Names of the topics that are read from front to back."""
        return [topic.name for topic in (self.image, self.odometry, self.truth) if topic is not None]


def _choose(bag: Bag, role: str, types: tuple[str, ...], name: str | None, *, required: bool = False) -> Topic | None:
    option, expected = f"--{role}-topic", " or ".join(types)
    if name == "" and not required:
        return None
    if name:
        if name not in bag.topics:
            raise SequenceError(f"{bag.path}: no topic {name} ({option}); {_listing(bag.topics.values())}")
        chosen = bag.topics[name]
        if chosen.type not in types:
            raise SequenceError(f"{bag.path}: {name} is {chosen.type}, expected {expected} for {option}")
    else:
        candidates = [topic for topic in bag.topics.values() if topic.type in types and topic.num_messages]
        if not candidates and not required:
            return None
        if not candidates:
            raise SequenceError(
                f"{bag.path}: no {role} topic, expected one of type {expected}; {_listing(bag.topics.values())}"
            )
        if len(candidates) > 1:
            none = "" if required else ", or '' for none"
            raise SequenceError(
                f"{bag.path}: {len(candidates)} {role} topics, expected one; name it by {option}{none};"
                f" {_listing(candidates)}"
            )
        chosen = candidates[0]
    if chosen.encoding != "cdr":
        raise SequenceError(f"{bag.path}: {chosen.name} is encoded as {chosen.encoding!r}, expected ROS 2's 'cdr'")
    return chosen


def _listing(topics: Iterable[Topic]) -> str:
    """Topics with their types, for messages of errors."""
    return f"found {', '.join(f'{topic.name} ({topic.type})' for topic in topics) or 'no topics'}"


def _decode(bag: Bag, raw: RawMessage, *, tolerate: bool = False) -> SimpleNamespace | None:
    """Fields of a message; where its bytes are no such message, an error or, if tolerated, None."""
    message_type = bag.topics[raw.topic].type
    try:
        return decoder(message_type)(raw.data)
    except Exception as error:  # the library lets struct, index and unicode errors through
        if tolerate:
            return None
        raise SequenceError(
            f"{bag.path}: {raw.topic}: message logged at {raw.log_time_ns} ns has {len(raw.data)} bytes that are no"
            f" {message_type}: {type(error).__name__}: {error}"
        ) from error


def _first(bag: Bag, topic: Topic) -> SimpleNamespace:
    """First message of a topic that can be decoded."""
    for raw in bag.messages([topic.name]):
        if (message := _decode(bag, raw, tolerate=True)) is not None:
            return message
    raise SequenceError(f"{bag.path}: no readable message on {topic.name} ({topic.type}), expected at least one")


def _read_camera(bag: Bag, topic: Topic | None) -> Camera | None:
    return camera_from_message(_first(bag, topic)) if topic is not None and topic.num_messages else None


def _pose_of_numbers(numbers: Iterable[float]) -> Poses:
    given = np.array([*numbers], np.float64)
    return Poses.from_quat_xyzw(given[:3], given[3:])


def _read_extrinsics(bag: Bag, options: SequenceOptions, image: Topic, odometry: Topic) -> Poses:
    """Pose of the camera in the odometry's child frame: given, the identity where both are one, or from tf."""
    if options.base_from_camera is not None:
        return _pose_of_numbers(options.base_from_camera)
    base = frame_name(_first(bag, odometry).child_frame_id)
    camera = frame_name(options.camera_frame or _first(bag, image).header.frame_id)
    if base and base == camera:
        return Poses.identity()
    tree = TransformTree()
    for name in ("/tf_static", "/tf"):
        if name not in bag.topics:
            continue
        # A camera is fixed to its robot: reading stops where its transform is complete.
        for raw in bag.messages([name]):
            message = _decode(bag, raw)
            assert message is not None
            try:
                tree.add(transforms_from_message(message))
            except SequenceError as error:
                raise SequenceError(f"{bag.path}: {name}: message logged at {raw.log_time_ns} ns: {error}") from error
            if base and camera and (base_from_camera := tree.between(base, camera)) is not None:
                return base_from_camera
    raise SequenceError(
        f"{bag.path}: no transform from {base!r} ({odometry.name}, child frame) to {camera!r} ({image.name})"
        f" on /tf_static or /tf, found frames: {', '.join(tree.frames) or 'none'}; expected a chain of transforms"
        " between the two (or name --camera-frame, or give --base-from-camera)"
    )
