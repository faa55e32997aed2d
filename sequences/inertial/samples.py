"""The samples of an inertial measurement unit in a recording, about the axes of the camera.

`sensor_msgs/Imu` by REP-145: specific force (up at rest) in m/s², turn rates in rad/s, and an orientation in a world
whose z is up; a covariance that begins with -1 says that there is none.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int64

from filtering.so3 import rotation_from_quat_xyzw
from sequences.errors import NotFoundError, SequenceError
from sequences.options import SequenceOptions
from sequences.reading.extrinsics import find_extrinsics
from sequences.reading.rig import find_cameras
from sequences.reading.timeline import Timeline
from sequences.recordings.bag import Bag
from sequences.recordings.messages import frame_name
from sequences.recordings.source import Topic, choose, first

STANDARD_GRAVITY = 9.80665
"""Metres per second squared."""
_OF_GRAVITY = (0.8, 1.2)  # median specific force in units of gravity
_LEAST_SATURATED, _SATURATED_G = 3, 1.5  # samples in a row at the same largest value, of so much
_UNIT = 0.05  # of a quaternion's length
_ORIENTATION_RAD = 0.02  # standard deviation of tilt where none is stated
_UNKNOWN_TILT = 0.1  # variance from which on an orientation is none, rad²
_AGREE_RAD = 0.35  # median angle between orientation and specific force
_FEWEST = 10


@dataclass(frozen=True)
class InertialSamples:
    """n samples about the axes of the camera, in increasing order of time.

    Attributes:
        times_ns: Stamps, integer nanoseconds, (n,).
        force: Specific force, m/s², (n, 3); NaN where it is unusable.
        turn_rate: rad/s, (n, 3); NaN where there is none.
        up: Up by the unit's own orientation, (n, 3); None where it has none.
        up_std_rad: Standard deviation of its tilt.
        notices: Sentences for users.
    """

    times_ns: Int64[np.ndarray, " n"]
    force: Float64[np.ndarray, "n 3"]
    turn_rate: Float64[np.ndarray, "n 3"]
    up: Float64[np.ndarray, "n 3"] | None = None
    up_std_rad: float = _ORIENTATION_RAD
    notices: tuple[str, ...] = ()


def read_inertial(path: Path, options: SequenceOptions) -> tuple[InertialSamples | None, list[str]]:
    """The samples of a recording; None where it has none that can be used, and sentences for users.

    The topic is the one named, or the one with the most messages of those whose frame tf links to the camera's.

    Args:
        path: MCAP file, rosbag2 folder or ROS 1 bag.
        options: Topics and frames.

    Raises:
        SequenceError: the file is damaged, or the topic that is named is missing, of another type, or not linked to the
            camera.
    """
    bag = Bag(path, stamps=options.stamps, tf_topic=options.tf_topic)
    if options.imu_topic == "":
        return None, []
    if options.imu_topic is not None:
        named = choose(bag, "imu", ("sensor_msgs/Imu",), options.imu_topic, required=True)
        topics = [] if named is None else [named]
    else:
        known = [topic for topic in bag.topics.values() if topic.read_as == "sensor_msgs/Imu" and topic.num_messages]
        topics = sorted(known, key=lambda topic: -topic.num_messages)
    problems: list[str] = []
    for topic in topics:
        try:
            camera_from_imu = _camera_from_imu(bag, topic, options)
        except (NotFoundError, SequenceError) as error:
            if options.imu_topic is not None:
                raise
            problems.append(f"{topic.name} is not used: {str(error).removeprefix(f'{bag.path}: ')}")
            continue
        others = f" of {len(topics)}" if len(topics) > 1 else ""
        found, notices = _read(bag, topic, camera_from_imu)
        return found, [*([f"{topic.name} is the inertial unit{others} (--imu-topic)"] if others else []), *notices]
    return None, problems


def _camera_from_imu(bag: Bag, topic: Topic, options: SequenceOptions) -> Float64[np.ndarray, "3 3"]:
    """The rotation from the unit's axes to the camera's."""
    camera, where = options.camera_frame, ""
    if not camera:
        (localized, *_), _ = find_cameras(bag, options)
        camera, where = first(bag, localized.image).header.frame_id, f" ({localized.name})"
    unit = frame_name(first(bag, topic).header.frame_id)
    mount = find_extrinsics(
        bag, unit, frame_name(camera), body_is=f" ({topic.name})", camera_is=where, instead="--imu-topic ''"
    )
    return mount.body_from_camera.rotation.T


def _read(
    bag: Bag, topic: Topic, camera_from_imu: Float64[np.ndarray, "3 3"]
) -> tuple[InertialSamples | None, list[str]]:
    times: list[int] = []
    rows: list[list[float]] = []
    num_left_out = 0
    for dated in Timeline(bag, {topic.name: None}).messages(topic.name):
        numbers = None if dated.message is None or not dated.stamps_ns else _numbers(dated.message)
        if numbers is None or (times and dated.stamps_ns[0][1] <= times[-1]):
            num_left_out += 1
            continue
        times.append(dated.stamps_ns[0][1])
        rows.append(numbers)
    notices = []
    if num_left_out:
        notices.append(f"{num_left_out} messages of {topic.name} are unusable, or not later than those before")
    if len(rows) < _FEWEST:
        return None, [*notices, f"{topic.name}: {len(rows)} messages can be used, expected at least {_FEWEST}"]
    table = np.array(rows)
    samples = prepared(topic.name, np.array(times, np.int64), table, camera_from_imu)
    return samples, [*notices, *samples.notices]


def _numbers(message: Any) -> list[float] | None:
    """Force, turn rate, orientation and whether each is given, and the variance of tilt; None where not finite."""
    a, w, q = message.linear_acceleration, message.angular_velocity, message.orientation
    numbers = [float(each) for each in (a.x, a.y, a.z, w.x, w.y, w.z, q.x, q.y, q.z, q.w)]
    given = [
        float(each[0] != -1.0)
        for each in (
            message.linear_acceleration_covariance,
            message.angular_velocity_covariance,
            message.orientation_covariance,
        )
    ]
    tilt = float(message.orientation_covariance[0] + message.orientation_covariance[4]) / 2.0
    if not np.isfinite([*numbers[6:], tilt]).all():  # drivers without one fill in NaN
        numbers[6:], given[2], tilt = [0.0] * 4, 0.0, 0.0
    numbers = [*numbers, *given, tilt]
    return numbers if np.isfinite(numbers).all() else None


def prepared(
    name: str,
    times_ns: Int64[np.ndarray, " n"],
    table: Float64[np.ndarray, "n 14"],
    camera_from_imu: Float64[np.ndarray, "3 3"],
) -> InertialSamples:
    """Samples in units of SI and about the camera's axes, of what can be used.

    Args:
        name: Of the topic.
        times_ns: Stamps.
        table: Force, turn rate, orientation as x y z w, whether each of these is given, variance of tilt.
        camera_from_imu: Rotation.
    """
    force, rate = table[:, :3].copy(), table[:, 3:6].copy()
    force[table[:, 10] == 0.0], rate[table[:, 11] == 0.0] = np.nan, np.nan
    notices: list[str] = []
    lengths = np.linalg.norm(force, axis=1)
    usual = float(np.median(lengths[np.isfinite(lengths)])) if np.isfinite(lengths).any() else np.nan
    if _OF_GRAVITY[0] < usual < _OF_GRAVITY[1]:
        notices.append(f"{name}: a specific force of {usual:.2f} is taken for one in g, and converted to m/s²")
        force *= STANDARD_GRAVITY
    elif np.isfinite(usual) and not _OF_GRAVITY[0] < usual / STANDARD_GRAVITY < _OF_GRAVITY[1]:
        notices.append(
            f"{name}: the specific force is {usual:.3g} m/s² (median), expected about {STANDARD_GRAVITY:.2f}: it is"
            " not used (a driver that takes gravity out, or another unit)"
        )
        force[:] = np.nan
    saturated = _saturated(force)
    if saturated.any():
        notices.append(f"{name}: {int(saturated.sum())} samples are saturated, and not used")
        force[saturated] = np.nan
    if not np.any(rate[np.isfinite(rate)]):  # a driver that fills in zeros
        rate[:] = np.nan
    up, std_rad = _orientation_up(table)
    if up is not None:
        cosine = np.vecdot(up, force) / np.maximum(np.linalg.norm(force, axis=1), 1e-12)
        cosine = cosine[np.isfinite(cosine)]
        off_rad = float(np.arccos(np.clip(np.median(cosine), -1.0, 1.0))) if len(cosine) else 0.0
        if off_rad > _AGREE_RAD:
            notices.append(
                f"{name}: its orientation is off the specific force by {np.degrees(off_rad):.0f}° (median), and not"
                " used"
            )
            up = None
    return InertialSamples(
        times_ns,
        force @ camera_from_imu.T,
        rate @ camera_from_imu.T,
        None if up is None else up @ camera_from_imu.T,
        std_rad,
        tuple(notices),
    )


def _orientation_up(table: Float64[np.ndarray, "n 14"]) -> tuple[Float64[np.ndarray, "n 3"] | None, float]:
    """Up in the unit's axes by its orientation, and its standard deviation; None where there is none.

    Zeros, and the identity throughout, are none: drivers fill them in.
    """
    quat, given = table[:, 6:10], table[:, 12] == 1.0
    unit = np.abs(np.linalg.norm(quat, axis=1) - 1.0) < _UNIT
    filled_in = np.ptp(quat, axis=0).max() == 0.0 and abs(quat[0, 3]) == 1.0
    if not (given & unit).all() or filled_in or np.median(table[:, 13]) > _UNKNOWN_TILT:
        return None, _ORIENTATION_RAD
    rotations = rotation_from_quat_xyzw(quat / np.linalg.norm(quat, axis=1, keepdims=True))
    variance = float(np.median(table[:, 13]))
    return rotations[:, 2, :].copy(), float(np.sqrt(variance)) if variance > 0.0 else _ORIENTATION_RAD


def _saturated(force: Float64[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
    """Which samples are at the largest value of an axis, several in a row: the end of the sensor's range."""
    found = np.zeros(len(force), bool)
    for axis in np.abs(force).T:
        largest = np.nanmax(axis) if np.isfinite(axis).any() else 0.0
        if largest < _SATURATED_G * STANDARD_GRAVITY:
            continue
        at = axis >= largest * (1.0 - 1e-9)
        ends = np.flatnonzero(np.diff(np.concatenate([[0], at.astype(int), [0]])))
        for begin, end in zip(ends[::2], ends[1::2], strict=True):
            if end - begin >= _LEAST_SATURATED:
                found[begin:end] = True
    return found
