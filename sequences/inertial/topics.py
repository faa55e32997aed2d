"""Inertial units and barometers among the topics of a recording or of a running system, and recordings of them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from filtering.errors import counted, listed
from sequences.errors import NotFoundError, SequenceError
from sequences.inertial.barometer import Barometer, Ride
from sequences.inertial.samples import InertialSamples, InertialUnit
from sequences.options import ReadingOptions, SequenceOptions
from sequences.reading.extrinsics import find_extrinsics
from sequences.reading.rig import find_cameras
from sequences.reading.timeline import Timeline
from sequences.recordings.bag import Bag
from sequences.recordings.messages import frame_name
from sequences.recordings.source import MessageSource, Topic, choose, first

IMU_TYPE, PRESSURE_TYPE = "sensor_msgs/Imu", "sensor_msgs/FluidPressure"
_AS_MANY = 0.8  # of the most messages: topics of one rate
_FEWEST = 10
_NAMED = 3  # topics, in a sentence


def find_inertial(
    bag: MessageSource, options: ReadingOptions, camera_frame: str, camera_is: str = ""
) -> tuple[InertialUnit | None, list[str]]:
    """The inertial unit, and sentences for users; None where there is none that can be used.

    The topic is the one named, or the one with the most messages of those whose frame tf links to the camera's; of
    several with about as many, the first by name.

    Args:
        bag: A recording, or a running system.
        options: The topic.
        camera_frame: Frame of the camera, in tf.
        camera_is: What it is of, for errors.

    Raises:
        SequenceError: the topic that is named is missing, of another type, or not linked to the camera.
    """
    topics = _candidates(bag, "imu", IMU_TYPE, options.imu_topic)
    problems: list[str] = []
    unlinked: dict[str, str] = {}  # frames of topics, by their names
    for topic in topics:
        try:
            unit = frame_name(first(bag, topic).header.frame_id)
        except SequenceError as error:
            if options.imu_topic is not None:
                raise
            problems.append(f"{topic.name} is not used: {str(error).removeprefix(f'{bag.path}: ')}")
            continue
        try:
            mount = find_extrinsics(
                bag, unit, camera_frame, body_is=f" ({topic.name})", camera_is=camera_is, instead="--imu-topic ''"
            )
        except NotFoundError:
            if options.imu_topic is not None:
                raise
            unlinked[topic.name] = unit
            continue
        notices = [f"{topic.name} is the inertial unit of {len(topics)} (--imu-topic)"] if len(topics) > 1 else []
        return InertialUnit(topic.name, mount.body_from_camera.rotation.T), notices
    if unlinked:
        problems.append(_not_linked(unlinked, f"{camera_frame!r}{camera_is}"))
    return None, problems


def _not_linked(units: Mapping[str, str], camera: str) -> str:
    """That tf does not link the frames of some topics, as of a gyroscope and an accelerometer, to the camera's."""
    frames = listed((repr(frame) for frame in dict.fromkeys(units.values())), _NAMED)
    return (
        f"{listed(units, _NAMED)} {'are' if len(units) > 1 else 'is'} not used: no transforms on /tf_static or /tf lead"
        f" from {frames} to {camera}; record them, or name --camera-frame"
    )


def find_barometer(bag: MessageSource, options: ReadingOptions) -> Barometer | None:
    """The barometer named, or the one with the most messages; None without one.

    Raises:
        SequenceError: the topic named is missing or of another type.
    """
    topics = _candidates(bag, "pressure", PRESSURE_TYPE, options.pressure_topic)
    return Barometer(topics[0].name) if topics else None


def without_metres(barometer: str) -> str:
    """A sentence for users, where a barometer is of no use."""
    return f"{barometer} is not used: its heights are added to recorded or published odometry alone"


def _candidates(bag: MessageSource, role: str, message_type: str, named: str | None) -> list[Topic]:
    """The topic named, or all of a type, those with the most messages first."""
    if named == "":
        return []
    if named is not None:
        topic = choose(bag, role, (message_type,), named, required=True)
        return [] if topic is None else [topic]
    left = [topic for topic in bag.topics.values() if topic.read_as == message_type and topic.num_messages]
    left = sorted(left, key=lambda topic: topic.name)
    ordered: list[Topic] = []
    while left:
        most = max(topic.num_messages for topic in left)
        ordered += [topic for topic in left if topic.num_messages >= _AS_MANY * most]
        left = [topic for topic in left if topic not in ordered]
    return ordered


def read_inertial(path: Path, options: SequenceOptions) -> tuple[InertialSamples | None, list[str]]:
    """The samples of a recording; None where it has none that can be used, and sentences for users.

    Args:
        path: MCAP file, rosbag2 folder or ROS 1 bag.
        options: Topics and frames, see `find_inertial`.

    Raises:
        SequenceError: the file is damaged, or as `find_inertial`.
    """
    bag = Bag(path, stamps=options.stamps, tf_topic=options.tf_topic)
    camera, camera_is = options.camera_frame, ""
    if not camera and _candidates(bag, "imu", IMU_TYPE, options.imu_topic):
        (localized, *_), _ = find_cameras(bag, options)
        camera, camera_is = first(bag, localized.image).header.frame_id, f" ({localized.name})"
    unit, notices = find_inertial(bag, options, frame_name(camera or ""), camera_is)
    if unit is None:
        return None, notices
    for dated in Timeline(bag, {unit.name: None}).messages(unit.name):
        unit.take(dated.stamps_ns[0][1] if dated.stamps_ns else None, dated.message)
    samples = unit.samples()
    notices += unit.notices
    if samples is None:
        notices.append(f"{unit.name}: {counted(unit.num_taken, 'message')} can be used, expected at least {_FEWEST}")
    return samples, notices


def read_rides(path: Path, options: SequenceOptions) -> tuple[list[Ride], list[str]]:
    """The rides by `sensor_msgs/FluidPressure` of a recording, and sentences for users; none without a barometer.

    Args:
        path: MCAP file, rosbag2 folder or ROS 1 bag.
        options: The topic, see `find_barometer`.

    Raises:
        SequenceError: the file is damaged, or as `find_barometer`.
    """
    bag = Bag(path, stamps=options.stamps, tf_topic=options.tf_topic)
    barometer = find_barometer(bag, options)
    if barometer is None:
        return [], []
    for dated in Timeline(bag, {barometer.name: None}).messages(barometer.name):
        if dated.message is not None and dated.stamps_ns:
            barometer.take(dated.stamps_ns[0][1], float(dated.message.fluid_pressure))
    if barometer.num_used < _FEWEST:
        return [], [
            f"{barometer.name}: {counted(barometer.num_used, 'message')} can be used, expected at least {_FEWEST}"
        ]
    rides = barometer.rides()
    return rides, barometer.notices
