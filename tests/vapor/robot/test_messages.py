"""What a robot gets told, and what it says of where it is."""

from types import SimpleNamespace

import numpy as np
import pytest

from filtering.errors import VaporTrackError
from filtering.estimate import Estimate, Mode
from filtering.se3 import Poses
from filtering.storeys import Storeys
from sequences.recordings.message_definitions import decoder, encoder
from sequences.recordings.messages import covariance_to_ros
from vapor.robot.publisher import camera_of_initial_pose, diagnostics_message, pose_message

BASE = Poses.exp(np.array([2.0, -1.0, 0.0, 0.0, 0.0, 2.0]))
MOUNT = Poses.exp(np.array([0.3, 0.1, 1.2, 1.2, -1.2, 1.2]))
POSE = "geometry_msgs/PoseWithCovarianceStamped"


def fields(message):
    return decoder(message.type)(encoder(message.type)(message.fields))


def initial(base: Poses, variances) -> SimpleNamespace:
    """As RViz sends it."""
    covariance = np.diag(np.asarray(variances, float))
    told = {"pose": [*base.translation, *base.as_quat_xyzw()], "covariance": covariance.ravel()}
    told["pose"] = np.array(told["pose"])
    message = {"header": {"stamp": {"sec": 1, "nanosec": 0}, "frame_id": "map"}, "pose": told}
    return decoder(POSE)(encoder(POSE)(message))


def as_ros_has_it(camera: Poses, covariance: np.ndarray) -> np.ndarray:
    """Covariance of the base about the axes of the map, of one of the camera in the tangent at its pose."""
    carry = MOUNT.adjoint()
    return covariance_to_ros(carry @ covariance @ carry.T, camera @ MOUNT.inverse())


def test_what_rviz_states_comes_out_in_the_axes_of_the_map():
    priors = Poses(np.stack([np.eye(3)] * 4), np.array([[0, 0, z] for z in (0.0, 3.0, 6.0, 9.0)], float)) @ MOUNT
    camera, covariance = camera_of_initial_pose(initial(BASE, [0.25, 0.04, 0, 0, 0, 0.07]), MOUNT, priors)
    base = camera @ MOUNT.inverse()
    np.testing.assert_allclose(base.translation, [*BASE.translation[:2], 4.5])
    np.testing.assert_allclose(base.rotation, BASE.rotation, atol=1e-12)
    height = float(np.var([0, 3, 6, 9]))
    expected = np.diag([0.25, 0.04, height, 0.01, 0.01, 0.07])
    np.testing.assert_allclose(as_ros_has_it(camera, covariance), expected, rtol=0.05, atol=5e-4)


def test_a_stated_height_is_kept():
    priors = Poses(np.stack([np.eye(3)] * 2), np.array([[0, 0, 0], [0, 0, 9.0]]))
    camera, covariance = camera_of_initial_pose(initial(BASE, [0.25, 0.25, 0.01, 0.1, 0.1, 0.1]), MOUNT, priors)
    assert (camera @ MOUNT.inverse()).translation[2] == pytest.approx(0.0)
    expected = np.diag([0.25, 0.25, 0.01, 0.1, 0.1, 0.1])
    np.testing.assert_allclose(as_ros_has_it(camera, covariance), expected, rtol=0.05, atol=5e-4)


def test_a_covariance_is_positive_definite_for_whoever_reads_it():
    covariance = np.diag([1e12, 1e10, 1e8, 1e-3, 1e-4, 1e-5])
    told = fields(pose_message("pose", "map", 1, Poses.exp(np.array([0, 0, 0, 0.4, -1.0, 0.7])), covariance))
    told = np.reshape(told.pose.covariance, (6, 6))
    np.testing.assert_array_equal(told, told.T)
    assert np.linalg.eigvalsh(told).min() > 0.0
    for wrong in (-np.eye(6), np.full((6, 6), np.inf)):
        with pytest.raises(VaporTrackError, match="covariance to write"):
            pose_message("pose", "map", 1, Poses.identity(), wrong)


def test_a_variance_of_zero_is_no_certainty():
    priors = Poses.identity(2)
    _, covariance = camera_of_initial_pose(initial(BASE, np.zeros(6)), MOUNT, priors)
    assert np.linalg.eigvalsh(covariance)[0] > 1e-5


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda pose: setattr(pose.pose.orientation, "w", np.nan), "quaternion"),
        (lambda pose: np.copyto(pose.covariance[:1], np.nan), "not finite or above"),
        (lambda pose: np.copyto(pose.covariance[:1], np.inf), "not finite or above"),
        (lambda pose: np.copyto(pose.covariance[:1], -1.0), "negative eigenvalue"),
    ],
)
def test_an_unusable_pose_or_covariance_is_refused(change, message):
    stated = initial(BASE, np.ones(6))
    stated.pose.covariance = np.array(stated.pose.covariance, np.float64)
    change(stated.pose)
    with pytest.raises(VaporTrackError, match=message):
        camera_of_initial_pose(stated, MOUNT, Poses.identity(2))


def test_a_pose_has_its_covariance_about_the_axes_of_its_frame():
    turned = Poses.exp(np.array([0.0, 0.0, 0.0, 0.0, 0.0, np.pi / 2]))
    message = fields(pose_message("/estimate/base_pose", "map", 5, turned, np.diag([4.0, 1, 1, 1, 1, 1])))
    covariance = np.array(message.pose.covariance).reshape(6, 6)
    np.testing.assert_allclose(np.diag(covariance)[:3], [1, 4, 1], atol=1e-12)
    assert message.header.frame_id == "map"
    assert message.header.stamp.nanosec == 5


def test_diagnostics_say_the_storey_and_how_much_of_the_belief_is_on_each():
    particles = Poses(np.tile(np.eye(3), (3, 1, 1)), np.array([[0.0, 0, 7.1], [0, 0, 3.9], [0, 0, 0.2]]))
    modes, covariances = (Mode(particles[2], np.eye(6), 0.7),), np.tile(np.eye(6), (3, 1, 1))
    estimate = Estimate(
        modes, "ambiguous", particles, covariances, np.log([0.5, 0.4, 0.1]), 0.0, 0.0, 1.0, 0.0, 0.0, 0.0
    )
    told = []
    for storeys in (Storeys((0.0, 4.0, 7.0)), None):
        message = diagnostics_message(0, hardware="m", estimate=estimate, silent=None, values={}, storeys=storeys)
        (status,) = fields(message).status
        told.append({each.key: each.value for each in status.values if "storey" in each.key})
    weights = {"weight of storey 0": "0.1000", "weight of storey 1": "0.4000", "weight of storey 2": "0.5000"}
    assert told == [{"storey": "2", **weights}, {}]


def test_before_anything_was_localized_diagnostics_are_stale():
    (status,) = fields(diagnostics_message(0, hardware="m", estimate=None, silent=None, values={"images": 3})).status
    assert (status.level, status.message) == (3, "no image was localized yet")
    assert [(each.key, each.value) for each in status.values] == [("images", "3")]
