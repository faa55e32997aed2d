"""One decoded ROS 2 message -> numpy and the types of this project.

ROS has pose covariances about the axes of the parent frame, twist covariances in the child frame, quaternions in x, y,
z, w order, and frame names with or without a leading slash.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Float64

from filtering.errors import VaporTrackError
from filtering.se3 import Poses

_MAX_DISTANCE_M = 1e8  # further than from any frame on Earth
_MAX_COVARIANCE = 1e12
# (3.2 m/s)², (3.2 rad/s)²: such an axis is not measured. Drivers write 100, 500, 999, 99999 or 1e6 for it; wheels,
# inertia and vision are a hundred times better.
_UNKNOWN_VARIANCE = 10.0


@dataclass(frozen=True)
class OdometrySample:
    """One odometry message: stamp, pose, and covariance of the velocity (v, ω) in the child frame, per second squared.

    The covariance is zero if unknown. An axis that is not measured is infinite on the diagonal, and zero beside it.
    """

    time_ns: int
    odom_from_base: Poses
    twist_covariance: Float64[np.ndarray, "6 6"]


@dataclass(frozen=True)
class FrameTransform:
    """One transform of a tf message: `parent_from_child`, with the names of both frames and its stamp."""

    parent: str
    child: str
    parent_from_child: Poses
    time_ns: int


def stamp_ns(header: Any) -> int:
    """Header stamp in integer nanoseconds."""
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


def frame_name(frame_id: str) -> str:
    """Name of a frame without the leading slash that older recordings carry."""
    return frame_id.lstrip("/")


def pose_from_message(message: Any) -> Poses:
    """geometry_msgs/Pose -> one pose. Raises VaporTrackError where it is not finite, too far away or no rotation."""
    p, q = message.position, message.orientation
    return _pose((p.x, p.y, p.z), (q.x, q.y, q.z, q.w))


def pose_from_transform(message: Any) -> Poses:
    """geometry_msgs/Transform -> one pose. Raises VaporTrackError as `pose_from_message`."""
    t, q = message.translation, message.rotation
    return _pose((t.x, t.y, t.z), (q.x, q.y, q.z, q.w))


def odometry_from_message(message: Any) -> OdometrySample:
    """nav_msgs/Odometry -> a sample.

    The pose covariance is ignored: it accumulates from the start, or is a placeholder. A twist covariance with −1 in
    its first element is unknown, and becomes zeros. A variance of 10 or more marks an axis that is not measured. Raises
    VaporTrackError where the pose or the twist covariance is not finite, or no covariance.
    """
    pose = pose_from_message(message.pose.pose)
    return OdometrySample(
        stamp_ns(message.header), pose, _twist_covariance(np.asarray(message.twist.covariance, np.float64).tobytes())
    )


@lru_cache(maxsize=64)  # many drivers state the same one always
def _twist_covariance(values: bytes) -> Float64[np.ndarray, "6 6"]:
    covariance = np.frombuffer(values).reshape(6, 6).copy()
    if covariance[0, 0] == -1.0:
        covariance = np.zeros((6, 6))
    unmeasured = np.flatnonzero(covariance.diagonal() >= _UNKNOWN_VARIANCE)  # infinity is, NaN is not
    covariance[unmeasured] = covariance[:, unmeasured] = 0.0
    if not np.isfinite(covariance).all() or np.abs(covariance).max() > _MAX_COVARIANCE:
        raise VaporTrackError(f"twist covariance is not finite or above {_MAX_COVARIANCE:g}: {covariance.tolist()}")
    if covariance.any():
        covariance = (covariance + covariance.T) / 2
        eigenvalue = float(np.linalg.eigvalsh(covariance)[0])
        if eigenvalue < -1e-9 * np.abs(covariance).max():
            raise VaporTrackError(f"twist covariance has the negative eigenvalue {eigenvalue:.3g}")
    covariance[unmeasured, unmeasured] = np.inf
    covariance.setflags(write=False)
    return covariance


def transforms_from_message(
    message: Any, links: Collection[tuple[str, str]] | None = None
) -> tuple[list[FrameTransform], list[str]]:
    """tf2_msgs/TFMessage -> its transforms (of some links, parent and child), and the problem of each unusable one."""
    transforms, problems = [], []
    for stamped in message.transforms:
        parent, child = frame_name(stamped.header.frame_id), frame_name(stamped.child_frame_id)
        if links is not None and (parent, child) not in links:
            continue
        try:
            pose = pose_from_transform(stamped.transform)
        except VaporTrackError as error:
            problems.append(f"transform {parent} -> {child}: {error}")
            continue
        transforms.append(FrameTransform(parent, child, pose, stamp_ns(stamped.header)))
    return transforms, problems


def covariance_to_ros(covariance: Float64[np.ndarray, "6 6"], pose: Poses) -> Float64[np.ndarray, "6 6"]:
    """Covariance in the tangent at a pose (axes of its child frame) -> as ROS has it, about the parent's axes."""
    turn = _turn(pose)
    return turn @ covariance @ turn.T


def covariance_from_ros(covariance: Float64[np.ndarray, "6 6"], pose: Poses) -> Float64[np.ndarray, "6 6"]:
    """Covariance of a pose as ROS has it, about the parent's axes -> in the tangent at the pose."""
    turn = _turn(pose)
    return turn.T @ covariance @ turn


def _pose(translation: tuple[float, float, float], quat_xyzw: tuple[float, float, float, float]) -> Poses:
    norm = math.hypot(*quat_xyzw)
    if not (all(abs(each) <= _MAX_DISTANCE_M for each in translation) and 0.9 < norm < 1.1):  # NaN compares as false
        if all(map(math.isfinite, (*translation, *quat_xyzw))):
            raise VaporTrackError(
                f"pose with translation {list(translation)} and quaternion of length {norm:.3g},"
                f" expected one within {_MAX_DISTANCE_M:g} m and a unit quaternion"
            )
        return Poses.from_quat_xyzw(np.array(translation), np.array(quat_xyzw))  # which names what is not finite
    # To the last bit `Poses.from_quat_xyzw`, in a tenth of the time.
    x, y, z, w = quat_xyzw
    for _ in range(2):
        norm = math.sqrt(x * x + y * y + z * z + w * w)
        x, y, z, w = x / norm, y / norm, z / norm, w / norm
    xx, yy, zz, ww = x * x, y * y, z * z, w * w
    xy, xz, yz, xw, yw, zw = x * y, x * z, y * z, x * w, y * w, z * w
    rotation = [
        [xx - yy - zz + ww, 2 * (xy - zw), 2 * (xz + yw)],
        [2 * (xy + zw), -xx + yy - zz + ww, 2 * (yz - xw)],
        [2 * (xz - yw), 2 * (yz + xw), -xx - yy + zz + ww],
    ]
    return Poses(np.array(rotation), np.array(translation))


def _turn(pose: Poses) -> np.ndarray:
    """Both halves of a tangent vector turned from the child's axes to the parent's."""
    turn = np.zeros((6, 6))
    turn[:3, :3] = turn[3:, 3:] = pose.rotation
    return turn
