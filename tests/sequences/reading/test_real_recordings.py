"""Recordings of real robots and cameras."""

from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest

from filtering.motion import MotionNoise
from filtering.se3 import Poses
from sequences.errors import SequenceError
from sequences.reader import SequenceReader
from sequences.recordings.bag import Bag
from sequences.recordings.message_definitions import decoder
from sequences.recordings.messages import odometry_from_message
from sequences.trajectories.interpolation import odometry_between
from tests.helpers.other_recordings import close


@pytest.mark.parametrize("name", ["nav2_turtlebot.mcap", "talker.mcap", "only_topics.mcap"])
def test_recordings_without_images_are_refused_with_a_list_of_topics(name: str, shared_data: Path) -> None:
    with pytest.raises(SequenceError, match=r"no image topic.*found /\w+.*\(\w+/\w+\)"):
        SequenceReader(shared_data / "ros_bags" / name)


def test_images_and_odometry_of_a_real_ros_1_bag_are_read(shared_data: Path) -> None:
    bag = Bag(shared_data / "ros_bags" / "t265_trimmed_locoffice.bag")
    images = [raw.decode() for raw in bag.messages(["/camera/fisheye1/image_raw"])]
    assert [(image.height, image.width, image.encoding) for image in images] == [(800, 848, "mono8")] * 3
    assert all(40 < np.frombuffer(image.data, np.uint8).mean() < 200 for image in images)
    samples = [odometry_from_message(raw.decode()) for raw in bag.messages(["/camera/odom/sample"])]
    assert len(samples) == bag.topics["/camera/odom/sample"].num_messages == 19
    assert all(later.time_ns > earlier.time_ns for earlier, later in pairwise(samples))
    assert 0.0 < np.linalg.norm(np.ptp([s.odom_from_base.translation for s in samples], axis=0)) < 0.5


@pytest.mark.usefixtures("unchecked")
def test_odometry_of_a_real_robot_gets_the_motion_noise(shared_data: Path) -> None:
    """2639 messages with covariances of zero: increments over 0.5 s are those of a robot, and chain to its path."""
    decode = decoder("nav_msgs/Odometry")
    raws = Bag(shared_data / "ros_bags" / "nav2_turtlebot.mcap").messages(["/odom"])
    samples = [odometry_from_message(decode(raw.data)) for raw in raws]
    times_ns = np.array([s.time_ns for s in samples])
    poses = Poses.stack([s.odom_from_base for s in samples])
    twists = np.stack([s.twist_covariance for s in samples])
    assert len(samples) == 2639
    assert not twists.any()
    chained = poses[0]
    stamps = range(int(times_ns[0]), int(times_ns[-1]), 500_000_000)
    for start, end in pairwise(stamps):
        window = slice(np.searchsorted(times_ns, start, "right") - 1, np.searchsorted(times_ns, end) + 1)
        odometry = odometry_between(
            times_ns[window],
            poses[window],
            twists[window],
            start,
            end,
            base_from_camera=Poses.identity(),
            motion_noise=MotionNoise(),
        )
        moved_m = np.linalg.norm(odometry.previous_from_current.translation)
        assert moved_m < 0.5  # a TurtleBot drives 0.46 m/s at most
        deviation = np.sqrt(np.diag(odometry.covariance))
        assert 0.005 < deviation.min() <= deviation.max() < 0.05
        chained = chained @ odometry.previous_from_current
    last = np.searchsorted(times_ns, stamps[-1])
    assert close(chained, poses[last], 0.02)


def test_images_of_a_real_camera_decode(shared_data: Path) -> None:
    from sequences.images.decoding import decode_image_bytes

    file = next((shared_data / "tum_fr1").rglob("*.jpg"))
    image = decode_image_bytes(file.read_bytes())
    np.testing.assert_array_equal(image, cv2.cvtColor(cv2.imread(str(file), cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB))  # pyright: ignore[reportArgumentType, reportCallIssue]
