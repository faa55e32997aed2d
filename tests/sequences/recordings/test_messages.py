"""ROS messages of poses and odometry, and their conventions."""

from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from filtering.errors import VaporTrackError
from filtering.se3 import Poses
from sequences.recordings.bag import Bag
from sequences.recordings.messages import (
    covariance_to_ros,
    odometry_from_message,
    pose_from_message,
)


def test_the_pose_of_a_message_is_to_the_last_bit_that_of_a_batch() -> None:
    rng = np.random.default_rng(5)
    quats, translations = rng.normal(size=(200, 4)), rng.normal(size=(200, 3))
    quats[:4] = [0, 0, 0, 1], [0, 0, 1, 0], [0.5, 0.5, -0.5, 0.5], [0, 0, 0, -1.0]
    quats *= rng.uniform(0.91, 1.09, (200, 1)) / np.linalg.norm(quats, axis=-1, keepdims=True)
    found = [
        pose_from_message(odometry_message(position=t, quat=q).pose.pose)
        for t, q in zip(translations.tolist(), quats.tolist(), strict=True)
    ]
    expected = Poses.from_quat_xyzw(translations, quats)
    np.testing.assert_array_equal(Poses.stack(found).as_matrix(), expected.as_matrix())


def odometry_message(**change: object) -> SimpleNamespace:
    values = {"position": [1.0, 2.0, 3.0], "quat": [0.0, 0.0, 0.6, 0.8], "covariance": [0.0] * 36, **change}
    p, q = values["position"], values["quat"]
    pose = SimpleNamespace(
        position=SimpleNamespace(x=p[0], y=p[1], z=p[2]), orientation=SimpleNamespace(x=q[0], y=q[1], z=q[2], w=q[3])
    )
    return SimpleNamespace(
        header=SimpleNamespace(stamp=SimpleNamespace(sec=1_700_000_000, nanosec=123_456_789), frame_id="odom"),
        pose=SimpleNamespace(pose=pose, covariance=[9.0] * 36),
        twist=SimpleNamespace(covariance=values["covariance"]),
    )


def test_odometry_keeps_its_stamp_pose_and_twist_covariance() -> None:
    covariance = np.diag([1.0, 2, 3, 4, 5, 6])
    sample = odometry_from_message(odometry_message(covariance=covariance.ravel().tolist()))
    assert sample.time_ns == 1_700_000_000_123_456_789
    np.testing.assert_array_equal(sample.twist_covariance, covariance)
    np.testing.assert_allclose(sample.odom_from_base.apply(np.array([1.0, 0, 0])), [1.28, 2.96, 3.0], atol=1e-12)


@pytest.mark.parametrize("placeholder", [10.0, 999.0, 1e6, 1e300, np.inf])
def test_axes_with_a_placeholder_for_a_variance_are_infinite_and_the_others_stay(placeholder: float) -> None:
    covariance = np.diag([0.1, placeholder, placeholder, placeholder, 0.2, 0.3])
    covariance[0, 5] = covariance[5, 0] = 0.01
    covariance[0, 1] = covariance[1, 0] = 5.0
    sample = odometry_from_message(odometry_message(covariance=covariance.ravel().tolist()))
    expected = np.diag([0.1, np.inf, np.inf, np.inf, 0.2, 0.3])
    expected[0, 5] = expected[5, 0] = 0.01
    np.testing.assert_array_equal(sample.twist_covariance, expected)


def test_a_covariance_marked_as_unknown_becomes_zero() -> None:
    sample = odometry_from_message(odometry_message(covariance=[-1.0] + [0.0] * 35))
    assert not sample.twist_covariance.any()


@pytest.mark.parametrize(
    "change",
    [
        {"position": [np.nan, 0.0, 0.0]},
        {"quat": [0.0, 0.0, np.inf, 1.0]},
        {"quat": [0.0] * 4},
        {"quat": [0.0, 0.0, 0.0, 1e300]},
        {"position": [1e300, 0.0, 0.0]},
        {"covariance": [1.0, 1e300] + [0.0] * 34},
        {"covariance": [np.nan] * 36},
        {"covariance": (-np.eye(6) * 2).ravel().tolist()},
        {"covariance": np.diag([-1e-4, 0.1, 1e6, 1e6, 1e6, 0.1]).ravel().tolist()},  # which a placeholder does not hide
    ],
)
def test_odometry_that_is_no_motion_is_refused(change: dict) -> None:
    with pytest.raises(VaporTrackError):
        odometry_from_message(odometry_message(**change))


def test_covariance_of_a_pose_turns_to_the_axes_of_its_parent() -> None:
    # Uncertain along the camera's view and about it; the camera looks along the map's x axis (z -> x, x -> −y).
    map_from_camera = Poses(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]), np.array([5.0, 6, 7]))
    covariance = np.diag([0.0, 0, 4.0, 0, 0, 0.25])
    np.testing.assert_allclose(covariance_to_ros(covariance, map_from_camera), np.diag([4.0, 0, 0, 0.25, 0, 0]))


def test_images_and_odometry_of_a_real_ros_1_bag_are_read(shared_data: Path) -> None:
    bag = Bag(shared_data / "ros_bags" / "t265_trimmed_locoffice.bag")
    images = [raw.decode() for raw in bag.messages(["/camera/fisheye1/image_raw"])]
    assert [(image.height, image.width, image.encoding) for image in images] == [(800, 848, "mono8")] * 3
    assert all(40 < np.frombuffer(image.data, np.uint8).mean() < 200 for image in images)
    samples = [odometry_from_message(raw.decode()) for raw in bag.messages(["/camera/odom/sample"])]
    assert len(samples) == bag.topics["/camera/odom/sample"].num_messages == 19
    assert all(later.time_ns > earlier.time_ns for earlier, later in pairwise(samples))
    assert 0.0 < np.linalg.norm(np.ptp([s.odom_from_base.translation for s in samples], axis=0)) < 0.5
