"""Cameras, hypotheses and images in the form in which Rerun shows them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float32, Float64, UInt8

from filtering.estimate import Mode
from filtering.motion import Odometry
from filtering.se3 import Poses
from sequences.frame import Camera, Frame
from vapor.reporting.drawing import as_jpeg, shrunk

if TYPE_CHECKING:
    import rerun as rr

SMALL_SIDE, _IMAGE_SIDE = 240, 480  # pixels
_JPEG_QUALITY = 75


def thinned(poses: Poses, count: int) -> Poses:
    """At most `count` of the poses (n,), evenly spaced in their order."""
    return poses[np.linspace(0, len(poses) - 1, min(count, len(poses))).round().astype(np.int64)]


def frusta(poses: Poses, size_m: float) -> Float32[np.ndarray, "n 10 3"]:
    """Cameras (n,) as one line each, which goes along every edge of the pyramid from the centre to the image."""
    x, y = 0.5 * size_m, 0.375 * size_m
    corners = np.array([[-x, -y, size_m], [x, -y, size_m], [x, y, size_m], [-x, y, size_m]])
    line = np.concatenate([corners, np.zeros((1, 3))])[[1, 0, 3, 4, 0, 3, 2, 4, 1, 2]]
    points = line @ np.swapaxes(poses.rotation, 1, 2) + poses.translation[:, None]
    return points.astype(np.float32)


def steps(points: Float64[np.ndarray, "n 3"], limit_m: float = np.inf) -> Float32[np.ndarray, "n 2 3"]:
    """From each point of a path to the next, the first one by itself, like those that are further from the last."""
    begins = np.concatenate([points[:1], points[:-1]])
    jumps = np.linalg.norm(points - begins, axis=1) > limit_m
    begins[jumps] = points[jumps]
    return np.stack([begins, points], axis=1).astype(np.float32)


def ellipsoids(
    covariances: Float64[np.ndarray, "n 3 3"],
) -> tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, "n 3 3"]]:
    """Standard deviations along the principal axes, and the axes as right-handed rotations."""
    variances, axes = np.linalg.eigh((covariances + np.swapaxes(covariances, 1, 2)) / 2)
    axes[:, :, 2] *= np.linalg.det(axes)[:, None]
    return np.sqrt(np.maximum(variances, 1e-8)), axes


BEST = (50, 135, 255)
"""The colour of the best hypothesis."""
_OTHERS = (
    (235, 95, 30),
    (225, 120, 200),
    (240, 228, 66),
    (190, 130, 70),
    (230, 45, 100),
    (150, 200, 40),
    (255, 180, 170),
    (120, 130, 60),
    (0, 200, 200),
    (160, 60, 60),
)


class HypothesisColors:
    """A colour for each hypothesis, as long as there is one where its motion leads; the best one is always blue.

    Args:
        length_m: A difference in position that counts as much as one of a radian.
    """

    def __init__(self, length_m: float) -> None:
        self._length_m = length_m
        self._poses: Poses | None = None
        self._numbers = np.zeros(0, np.int64)

    def of(self, poses: Poses, odometry: Odometry | None) -> UInt8[np.ndarray, "n 3"]:
        """Colours of the hypotheses after another image.

        Args:
            poses: world_from_camera, (n,), the best one first.
            odometry: Motion since the last image; None where unknown, which counts as none.
        """
        numbers = np.full(len(poses), -1)
        if self._poses is not None:
            moved = self._poses if odometry is None else self._poses @ odometry.previous_from_current
            from scipy.optimize import linear_sum_assignment  # only viewers need it, and every run would pay for it

            metres_sq, turned = poses.squared_distances(moved)
            here, before = linear_sum_assignment(metres_sq / self._length_m**2 + turned)
            numbers[here] = self._numbers[before]
        free = iter(sorted(set(range(2 * len(poses))) - set(numbers.tolist())))
        numbers = np.array([number if number >= 0 else next(free) for number in numbers.tolist()], np.int64)
        self._poses, self._numbers = poses, numbers
        colors = np.array(_OTHERS, np.uint8)[numbers % len(_OTHERS)]
        colors[0] = BEST
        return colors


def shown_modes(
    modes: Sequence[Mode], colors: UInt8[np.ndarray, "n 3"], *, camera_m: float
) -> Iterator[tuple[str, Any, dict[str, Any]]]:
    """Entity, archetype and components by name that show hypotheses, n ≥ 1, with cameras of a size in metres."""
    import rerun as rr

    poses = Poses.stack([mode.world_from_camera for mode in modes])
    sigma, axes = ellipsoids(np.stack([mode.covariance[:3, :3] for mode in modes]))
    turned = Poses(poses.rotation @ axes, poses.translation)
    yield (
        "world/modes",
        rr.Ellipsoids3D,
        {
            "centers": poses.translation,
            "half_sizes": 2.0 * sigma,
            "quaternions": turned.as_quat_xyzw(known_valid=True),
            "colors": colors,
        },
    )
    labels = [f"{100 * mode.weight:.0f} %" for mode in modes]
    points = poses.translation.astype(np.float32)
    yield "world/modes/weights", rr.Points3D, {"positions": points, "colors": colors, "labels": labels}
    yield "world/modes/cameras", rr.LineStrips3D, {"strips": frusta(poses, camera_m), "colors": colors}


@dataclass(frozen=True)
class Photograph:
    """A JPEG image, its size, and the rows of its matrix of intrinsics, in pixels of this size."""

    jpeg: bytes
    width: int
    height: int
    image_from_camera: list[list[float]]

    @staticmethod
    def of(frame: Frame, longest_side: int = _IMAGE_SIDE) -> Photograph:
        """The image of a frame, its longer side at most so many pixels; 60° across where the intrinsics are unknown."""
        height, width = frame.image.shape[:2]
        camera = frame.camera
        if camera is None:
            focal = float(width / (2.0 * np.tan(np.radians(30.0))))
            camera = Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)
        image = shrunk(frame.image, longest_side)
        height, width = image.shape[:2]
        own = camera.scaled(width, height)
        # Rerun's pixels begin at integers, ours lie on them.
        matrix = [[own.fx, 0.0, own.cx + 0.5], [0.0, own.fy, own.cy + 0.5], [0.0, 0.0, 1.0]]
        return Photograph(as_jpeg(image, _JPEG_QUALITY), width, height, matrix)

    def log(
        self, stream: rr.RecordingStream, entity: str, pose: Poses, *, color: tuple[int, int, int], size_m: float
    ) -> None:
        """Show it where it was taken, `size_m` in front of the camera at `pose`, world_from_camera."""
        import rerun as rr

        camera = rr.Pinhole(
            image_from_camera=self.image_from_camera,
            resolution=[self.width, self.height],
            image_plane_distance=size_m,
            color=color,
        )
        stream.log(entity, rr.Transform3D(translation=pose.translation, mat3x3=pose.rotation), static=True)
        stream.log(entity, camera, static=True)
        stream.log(entity, rr.EncodedImage(contents=self.jpeg, media_type="image/jpeg"), static=True)
