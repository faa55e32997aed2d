"""The parts of a sequence: cameras, frames and trajectories."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Int64, UInt8

from filtering.errors import quoted
from filtering.motion import Odometry
from filtering.se3 import Poses
from sequences.errors import SequenceError

ASSUMED_HZ = 30
"""The rate assumed where images have no time stamps: that of the sensor of 7-Scenes."""
BASE_FROM_CAMERA = Poses(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), np.zeros(3))
"""Extrinsics of a body that looks where its camera looks: x ahead, y left, z up."""
_PIXELS = 1e6  # beyond any image's side; tele lenses have focal lengths of some of these
_RANGES = (
    ("width", 1, _PIXELS),
    ("height", 1, _PIXELS),
    ("fx", 1e-6, 1e3 * _PIXELS),
    ("fy", 1e-6, 1e3 * _PIXELS),
    ("cx", -1e3 * _PIXELS, 1e3 * _PIXELS),
    ("cy", -1e3 * _PIXELS, 1e3 * _PIXELS),
)


@dataclass(frozen=True)
class Camera:
    """Pinhole camera, in pixels; axes x right, y down, z forward (OpenCV).

    Pixel centres lie at integer coordinates: the image spans [−½, width − ½] × [−½, height − ½].

    Raises:
        SequenceError: impossible numbers: not finite, sizes or focal lengths that are not positive, or
            any that is too large.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        for name, low, high in _RANGES:
            if not low <= (value := getattr(self, name)) <= high:  # NaN compares as false
                raise SequenceError(f"camera with {name} {quoted(value)}, expected between {low:g} and {high:g}")

    def scaled(self, width: int, height: int) -> Camera:
        """The same camera at another image size; the edge, half a pixel from the first centre, stays the edge."""
        if (width, height) == (self.width, self.height):
            return self
        sx, sy = width / self.width, height / self.height
        return Camera(width, height, self.fx * sx, self.fy * sy, (self.cx + 0.5) * sx - 0.5, (self.cy + 0.5) * sy - 0.5)

    def cropped(self, left: int, top: int, width: int, height: int) -> Camera:
        """The same camera when so many pixels are cut out of its image."""
        return Camera(width, height, self.fx, self.fy, self.cx - left, self.cy - top)


class Gravity(NamedTuple):
    """The direction of gravity.

    Attributes:
        up: Unit vector against it, about the axes of the camera that is localized.
        std_rad: Standard deviation about each axis across it.
    """

    up: tuple[float, float, float]
    std_rad: float


@dataclass(frozen=True)
class Frame:
    """One image of a sequence, with its time, odometry and true pose.

    Attributes:
        time_ns: Header stamp of the image, integer nanoseconds.
        image: RGB, uint8, undistorted; empty where there is none.
        odometry: Motion of the camera that is localized since the frame before it in time that was yielded; None for
            the first frame, and where no odometry covers it.
        world_from_camera: True pose of the camera that took the image, one pose; None where unknown.
        camera: Intrinsics of that image, a pinhole camera's; None where unknown.
        sequence: Which sequence of its data set it is from, counted from 0, where a data set has several.
        camera_name: Which of several cameras took the image; '' where there is one.
        reference_from_camera: Pose of that camera in the one that is localized, one pose; None where it is that one.
        gravity: By an inertial unit; None where it is unknown.
        number: Number of the image in its file or folder, by which `PATH@START:STOP` counts; None where it is not
            counted.
    """

    time_ns: int
    image: UInt8[np.ndarray, "height width 3"]
    odometry: Odometry | None = None
    world_from_camera: Poses | None = None
    camera: Camera | None = None
    sequence: int = 0
    camera_name: str = ""
    reference_from_camera: Poses | None = None
    gravity: Gravity | None = None
    number: int | None = None

    @property
    def world_from_reference(self) -> Poses | None:
        """True pose of the camera that is localized, one pose; None where unknown."""
        if self.world_from_camera is None or self.reference_from_camera is None:
            return self.world_from_camera
        return self.world_from_camera @ self.reference_from_camera.inverse()


@dataclass(frozen=True)
class Trajectory:
    """Time-stamped poses, in increasing order of time.

    Attributes:
        times_ns: Stamps in integer nanoseconds, strictly increasing.
        poses: world_from_camera, batch (n,).

    Raises:
        SequenceError: there are more of the ones than of the others.

    Example:
        >>> import numpy as np
        >>> import vapor
        >>> poses = vapor.Poses.exp(np.array([[0, 0, 0, 0, 0, 0], [0.1, 0, 0, 0, 0, 0]]))
        >>> trajectory = vapor.Trajectory(np.array([0, 100_000_000]), poses)
        >>> vapor.write_tum("mine.tum", trajectory)
    """

    times_ns: Int64[np.ndarray, " n"]
    poses: Poses

    def __post_init__(self) -> None:
        if np.shape(self.times_ns) != self.poses.batch_shape:
            shapes = f"{np.shape(self.times_ns)} and {self.poses.batch_shape}"
            raise SequenceError(f"times and poses of a trajectory have shapes {shapes}, expected (n,) both")

    def __len__(self) -> int:
        return len(self.times_ns)
