"""Frames -> a sequence as an MCAP file with ROS 2 messages, complete or not there at all."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float64, UInt8

from filtering.se3 import Poses
from sequences.errors import SequenceError
from sequences.frame import Camera
from sequences.images.undistortion import Lens, pinhole_of
from sequences.recordings.bag import METADATA_NAME, Bag
from sequences.recordings.mcap_writer import (
    BASE_FRAME,
    MAP_FRAME,
    ODOM_FRAME,
    MessageWriter,
    ros_header,
    ros_poses,
    ros_transform,
)

_JPEG_QUALITY = 92  # of images that are given as pixels
_CAMERA = "camera"


@dataclass(frozen=True)
class MountedCamera:
    """A camera on a robot: intrinsics of its images, with the distortion of a lens, and base_from_camera, one pose."""

    lens: Camera | Lens
    base_from_camera: Poses


class SequenceWriter(MessageWriter):
    """Writes a sequence that `SequenceReader`, ROS 2 and Foxglove read; use it in a `with` statement.

    Topics: `/camera/image/compressed`, `/camera/camera_info`, `/odom` (odom -> base_link), `/imu` if there is one,
    `/ground_truth/pose` (of the camera, in map), `/tf_static` (base_link -> camera_optical_frame); of another camera
    the same under its own name. Messages are logged at their stamps; write them roughly in order of time, so that
    readers need to hold little.
    """

    def __init__(
        self,
        path: Path,
        *,
        camera: Camera | Lens,
        base_from_camera: Poses,
        others: Mapping[str, MountedCamera] = {},
        metadata: Mapping[str, str] = {},
    ):
        """Set up a writer; the file is opened on entering the `with` statement.

        Args:
            path: File to write.
            camera: Intrinsics of the images as they are written, with the distortion of a lens.
            base_from_camera: Extrinsics, one pose.
            others: More cameras, by names that are not "camera".
            metadata: Of the file; `images` and `odometry` state their sources.
        """
        super().__init__(path)
        self._cameras = {_CAMERA: MountedCamera(camera, base_from_camera), **others}
        self._metadata = dict(metadata)
        self._has_tf = False

    def __enter__(self) -> SequenceWriter:
        self._open()
        if self._metadata:
            self._writer.add_metadata(METADATA_NAME, self._metadata)
        return self

    def write_image(self, time_ns: int, image_rgb: UInt8[np.ndarray, "height width 3"], camera: str = _CAMERA) -> None:
        """Write an image as JPEG."""
        bgr = cv2.cvtColor(image_rgb, cv2.COLOR_RGB2BGR)
        encoded, data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
        if not encoded:
            raise SequenceError(f"{self.path}: image at {time_ns} ns of shape {image_rgb.shape} cannot be encoded")
        self.write_encoded_image(time_ns, data.tobytes(), "jpeg", camera)

    def write_encoded_image(self, time_ns: int, data: bytes, format: str, camera: str = _CAMERA) -> None:
        """Write the bytes of a JPEG or PNG as they are; `format` is "jpeg" or "png"."""
        header = self._header(time_ns, _optical_frame(camera))
        image = {"header": header, "format": format, "data": data}
        self._write(f"/{camera}/image/compressed", "sensor_msgs/CompressedImage", image, time_ns)
        stated = self._cameras[camera].lens
        lens = stated if isinstance(stated, Lens) else Lens(stated, "plumb_bob", (0.0,) * 5)
        c, p, d = lens.camera, pinhole_of(stated), list(lens.coefficients)
        if lens.model == "equidistant" and not any(d):
            d[-1] = 1e-12  # zeros would mean no distortion
        info = {
            "header": header,
            "height": c.height,
            "width": c.width,
            "distortion_model": lens.model,
            "d": d,
            "k": [c.fx, 0.0, c.cx, 0.0, c.fy, c.cy, 0.0, 0.0, 1.0],
            "r": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
            "p": [p.fx, 0.0, p.cx, 0.0, 0.0, p.fy, p.cy, 0.0, 0.0, 0.0, 1.0, 0.0],
        }
        self._write(f"/{camera}/camera_info", "sensor_msgs/CameraInfo", info, time_ns)

    def write_odometry(self, time_ns: int, odom_from_base: Poses, twist_covariance: Float64[np.ndarray, "6 6"]) -> None:
        """Write one odometry message.

        Args:
            time_ns: Header stamp.
            odom_from_base: One pose.
            twist_covariance: Covariance of the velocity (v, ω) in the base frame; zeros where it is unknown.
        """
        message = {
            "header": self._header(time_ns, ODOM_FRAME),
            "child_frame_id": BASE_FRAME,
            "pose": {"pose": ros_poses(odom_from_base)},
            "twist": {"covariance": twist_covariance},
        }
        self._write("/odom", "nav_msgs/Odometry", message, time_ns)

    def write_inertial(
        self, time_ns: int, force: Float64[np.ndarray, "3"], turn_rate: Float64[np.ndarray, "3"]
    ) -> None:
        """Write one message of an inertial unit on the body: specific force, m/s², and turn rate, rad/s."""
        message = {
            "header": self._header(time_ns, BASE_FRAME),
            "orientation_covariance": [-1.0, *[0.0] * 8],
            "angular_velocity": turn_rate,
            "linear_acceleration": force,
        }
        self._write("/imu", "sensor_msgs/Imu", message, time_ns)

    def write_true_pose(self, time_ns: int, world_from_camera: Poses) -> None:
        """Write one true pose of the camera."""
        message = {"header": self._header(time_ns, MAP_FRAME), "pose": ros_poses(world_from_camera)}
        self._write("/ground_truth/pose", "geometry_msgs/PoseStamped", message, time_ns)

    def _header(self, time_ns: int, frame_id: str) -> dict:
        """A header; the static transform goes out with the first message, which has a stamp to give it."""
        if not self._has_tf:
            self._has_tf = True
            transforms = [
                ros_transform(time_ns, BASE_FRAME, _optical_frame(name), ros_poses(camera.base_from_camera))
                for name, camera in self._cameras.items()
            ]
            self._write("/tf_static", "tf2_msgs/TFMessage", {"transforms": transforms}, time_ns)
        return ros_header(time_ns, frame_id)


def _optical_frame(camera: str) -> str:
    return f"{camera}_optical_frame"


def is_own_sequence(path: Path) -> bool:
    """Whether a file is an MCAP file that a `SequenceWriter` wrote, with metadata."""
    try:
        return METADATA_NAME in Bag(path).metadata
    except SequenceError:
        return False
