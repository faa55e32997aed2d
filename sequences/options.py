"""Options of reading a recorded sequence."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from filtering.errors import VaporTrackError, require_within
from filtering.motion import MotionNoise
from filtering.se3 import Poses
from sequences.errors import SequenceError
from sequences.trajectories.pose_lines import require_columns
from sequences.trajectories.pose_tables import times_beside

OdometryUse = Literal["required", "auto", "optional", "ignored", "unread"]
OdometryOrigin = Literal["recorded", "visual", "both"]
TruePoseUse = Literal["required", "optional"]

_MAX_DURATION_S = 1e9  # of a recording; NaN and infinity are none
_MAX_OFFSET_S = 1e10  # between two clocks, one of which began in 1970
_MAX_ORIGIN_M = 1e8  # further than from any frame on Earth


@dataclass(frozen=True)
class ReadingOptions:
    """What to read of a recording or a running system. Topics are found by their type where there is only one."""

    image_topic: str | None = None
    """Topic of the images: sensor_msgs/Image or CompressedImage, foxglove.RawImage, CompressedImage or CompressedVideo,
    or ffmpeg_image_transport's FFMPEGPacket. Several cameras are separated by commas, and the first one is localized.
    Default: all cameras whose frames tf connects, in the order of their names."""
    odometry_topic: str | None = None
    """Topic of the odometry, nav_msgs/Odometry. Default: the only one of that type."""
    odometry_frame: str | None = None
    """Take the odometry from tf: the camera's motion in this frame. Default: odom, if there is no topic of odometry and
    tf has that frame."""
    camera_info_topic: str | None = None
    """Topic of the intrinsics, sensor_msgs/CameraInfo or foxglove.CameraCalibration; '' for none. Default: the one
    beside the image topic."""
    tf_topic: str | None = None
    """Topic of the transforms, tf2_msgs/TFMessage, with the static ones beside it: /robot1/tf, /robot1/tf_static.
    Default: /tf; where there is none, the only one whose name ends in /tf."""
    undistort: bool = True
    """Remove lens distortion by the intrinsics (CameraInfo, COLMAP)."""
    camera_frame: str | None = None
    """Frame of the camera, for tf. Default: the frame in the header of the images."""
    base_from_camera: tuple[float, float, float, float, float, float, float] | None = None
    """Pose of the camera on the robot, tx ty tz qx qy qz qw, instead of tf. The robot's frame is the child frame of the
    odometry; without odometry, the frame of the true poses."""
    motion_noise: MotionNoise = field(default_factory=MotionNoise)
    """Noise of odometry whose messages carry no covariance (zeros, or -1 first), and of the axes that they state a
    variance of 10 or more for, a placeholder for unmeasured axes."""
    imu_topic: str | None = None
    """Topic of the inertial unit, sensor_msgs/Imu, whose gravity corrects the tilt; '' for none. Default: the one with
    the most messages, where tf links it to the camera."""
    pressure_topic: str | None = None
    """Topic of a barometer, sensor_msgs/FluidPressure, which shows rides in lifts; '' for none."""
    stamps: Literal["header", "log"] = "header"
    """Which time a message has: the stamp in its header, or when it was logged. Messages without a stamp always have
    the latter."""

    def __post_init__(self) -> None:
        for name in ("image_topic", "odometry_topic", "tf_topic"):
            if getattr(self, name) == "":
                raise SequenceError(f"{name} is '', expected the name of a topic: it cannot be left out")
        for name in ("odometry_frame", "ground_truth_frame", "ground_truth_child_frame"):
            if getattr(self, name, None) == "":
                raise SequenceError(f"{name} is '', expected the name of a frame, or that it is left out")
        if self.base_from_camera is not None:
            try:
                pose_of_numbers(self.base_from_camera)
            except VaporTrackError as error:
                raise SequenceError(f"--base-from-camera: {error}; expected tx ty tz qx qy qz qw") from error
        if len(set(self.image_topics)) < len(self.image_topics) or "" in self.image_topics:
            raise SequenceError(f"--image-topic {self.image_topic}, expected names separated by commas, each once")
        if len(self.image_topics) > 1 and self.camera_info_topic:
            raise SequenceError("--camera-info-topic beside several cameras, expected each one's beside its images")
        if self.odometry_topic is not None and self.odometry_frame is not None:
            raise SequenceError("--odometry-topic and --odometry-frame are both given, expected one of them")

    @property
    def image_topics(self) -> tuple[str, ...]:
        """Names of the cameras' topics; none where none is named."""
        return () if self.image_topic is None else tuple(name.strip() for name in self.image_topic.split(","))


@dataclass(frozen=True)
class SequenceOptions(ReadingOptions):
    """What to read of a sequence. Topics are found by their type where there is only one."""

    ground_truth_topic: str | None = None
    """Topic of true poses: geometry_msgs/PoseStamped, PoseWithCovarianceStamped or TransformStamped, nav_msgs/Odometry
    or Path, foxglove.PoseInFrame or PosesInFrame; '' for none."""
    ground_truth_frame: str | None = None
    """Take true poses from tf: the camera's poses in this frame, such as map."""
    poses: Path | None = None
    """Take true poses from a file: TUM text, EuRoC's data.csv, or KITTI's with times.txt beside it."""
    poses_columns: str | None = None
    """Columns of a file of poses in another format, in quotation marks: "time tx ty tz qw qx qy qz _". `name` stands
    for frames that are named by their stamps, _ for columns to ignore."""
    time_offset_s: float | Literal["auto"] = 0.0
    """Seconds to add to the stamps of the file of poses; auto finds them by comparing its rotation with odometry's."""
    ground_truth_child_frame: str | None = None
    """Frame on the robot that the true poses are of. Default: the one that the messages name, else the camera's."""
    ground_truth_origin: tuple[float, float, float] | None = None
    """Point to subtract from the positions of true poses, x y z in metres: for coordinates far from zero, as of UTM."""
    allow_few_images: bool = False
    """Go on even if fewer than one image in ten can be used."""
    start_s: float = 0.0
    """Begin so many seconds after the first image."""
    duration_s: float | None = None
    """Seconds to read. Default: to the end."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_within(self, start_s=(0.0, _MAX_DURATION_S))
        if self.duration_s is not None:
            require_within(self, duration_s=(0.0, _MAX_DURATION_S))
        self._check_true_poses()

    @property
    def stated(self) -> dict[str, Any]:
        """All of them by name, as JSON."""
        return json.loads(json.dumps(asdict(self), default=str))

    @property
    def files_read(self) -> tuple[Path, ...]:
        """Files beside the sequence that are read, or looked for."""
        if self.poses is None:
            return ()
        return self.poses, times_beside(self.poses)

    def _check_true_poses(self) -> None:
        given = [
            f"--{name.replace('_', '-')}"
            for name in ("ground_truth_topic", "ground_truth_frame", "poses")
            if getattr(self, name) is not None
        ]
        if len(given) > 1:
            raise SequenceError(f"{' and '.join(given)} all state where true poses are, expected one of them")
        about = self.time_offset_s != 0.0 or self.poses_columns is not None
        if self.poses is None and about:
            raise SequenceError(
                "--time-offset-s and --poses-columns are about a file of poses, expected --poses with them"
            )
        require_columns("--poses-columns", self.poses_columns)
        if self.time_offset_s != "auto" and not abs(self.time_offset_s) <= _MAX_OFFSET_S:
            raise SequenceError(f"time_offset_s is {self.time_offset_s}, expected at most {_MAX_OFFSET_S:g} or auto")
        origin = self.ground_truth_origin
        if origin is not None and not (np.abs(origin) <= _MAX_ORIGIN_M).all():
            raise SequenceError(f"ground_truth_origin is {origin}, expected numbers within {_MAX_ORIGIN_M:g} m")


def pose_of_numbers(numbers: Iterable[float]) -> Poses:
    """One pose from tx ty tz qx qy qz qw. Raises VaporTrackError where these are none."""
    given = np.array([*numbers], np.float64)
    return Poses.from_quat_xyzw(given[:3], given[3:])
