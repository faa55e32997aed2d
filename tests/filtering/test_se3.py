import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.linalg import expm
from scipy.spatial.transform import RigidTransform, Rotation

from filtering.errors import VaporTrackError
from filtering.se3 import Poses

BATCHES = [(), (1,), (3, 1, 2)]
tangents = hnp.arrays(np.float64, 6, elements=st.floats(-1.8, 1.8))


def hat(tangent):
    v, w = tangent[:3], tangent[3:]
    return np.array([[0, -w[2], w[1], v[0]], [w[2], 0, -w[0], v[1]], [-w[1], w[0], 0, v[2]], [0, 0, 0, 0]])


def random_poses(seed, *batch):
    return Poses.exp(np.random.default_rng(seed).uniform(-1.7, 1.7, (*batch, 6)))


def assert_same(a, b, atol=1e-12):
    np.testing.assert_allclose(a.as_matrix(), np.broadcast_to(b.as_matrix(), a.as_matrix().shape), atol=atol)


@given(tangents)
def test_exp_is_the_matrix_exponential(tangent):
    np.testing.assert_allclose(Poses.exp(tangent).as_matrix(), expm(hat(tangent)), atol=1e-11)


@pytest.mark.parametrize("scale", [1e-7, 1e-3, 0.999e-2, 1.001e-2, 1.0, np.pi - 1e-7])
def test_exp_and_log_agree_with_gtsam_at_every_angle(scale):
    rng = np.random.default_rng(1)
    omega = rng.standard_normal(3)
    tangent = np.concatenate([rng.standard_normal(3), scale * omega / np.linalg.norm(omega)])
    theirs = gtsam.Pose3.Expmap(tangent[[3, 4, 5, 0, 1, 2]])
    np.testing.assert_allclose(Poses.exp(tangent).as_matrix(), theirs.matrix(), atol=1e-12)
    np.testing.assert_allclose(Poses.from_matrix(theirs.matrix()).log(), tangent, atol=1e-6)


@pytest.mark.parametrize("batch", BATCHES)
def test_group_laws_hold_over_batches(batch):
    a, b, c = random_poses(1, *batch), random_poses(2, *batch), random_poses(3, *batch)
    assert_same((a @ b) @ c, a @ (b @ c))
    assert_same(a @ a.inverse(), Poses.identity(*batch))
    assert_same(a @ Poses.identity(), a)
    assert (a @ b).batch_shape == batch


@pytest.mark.parametrize("batch", BATCHES)
def test_quaternions_round_trip_in_xyzw_order(batch):
    poses = random_poses(4, *batch)
    assert_same(Poses.from_quat_xyzw(poses.translation, poses.as_quat_xyzw()), poses)
    np.testing.assert_array_equal(poses.as_quat_xyzw(known_valid=True), poses.as_quat_xyzw())
    quarter_about_z = Poses.from_quat_xyzw(np.zeros(3), np.array([0, 0, np.sqrt(0.5), np.sqrt(0.5)]))
    np.testing.assert_allclose(quarter_about_z.apply(np.array([1.0, 0, 0])), [0, 1, 0], atol=1e-12)


@pytest.mark.parametrize("batch", BATCHES)
def test_matrices_and_rotations_of_scipy_round_trip_to_the_last_bit(batch):
    poses = random_poses(4, *batch)
    again = Poses.from_matrix(poses.as_matrix().tolist())
    np.testing.assert_array_equal(again.as_matrix(), poses.as_matrix())
    rotation = poses.as_rotation()
    np.testing.assert_array_equal(rotation.as_quat(canonical=True), poses.as_quat_xyzw())
    theirs = RigidTransform.from_components(poses.translation, rotation)
    assert_same(Poses.from_matrix(theirs.as_matrix()), poses)
    assert_same(Poses.from_rotation(poses.translation, rotation), poses)
    assert Poses.from_rotation(poses.translation, rotation).batch_shape == batch


def test_a_pose_is_made_of_lists():
    quarter = Poses.from_rotation([1, 2, 3], Rotation.from_euler("z", 90, degrees=True))
    assert_same(quarter, Poses.from_quat_xyzw([1, 2, 3], [0, 0, 1, 1]))
    assert_same(quarter, Poses.from_matrix([[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]))


def test_a_matrix_that_was_rounded_gives_the_nearest_rotation():
    exact = random_poses(7, 20)
    rounded = Poses.from_matrix(exact.as_matrix().round(4))
    products = rounded.rotation @ np.swapaxes(rounded.rotation, 1, 2)
    np.testing.assert_allclose(products, np.broadcast_to(np.eye(3), products.shape), atol=1e-14)
    assert_same(rounded, exact, atol=2e-4)


BAD_MATRICES = {
    r"matrix has shape \(3, 4\), expected \(\*batch, 4, 4\)": np.eye(4)[:3],
    "matrix 1 is .*nan.*, expected finite numbers": np.stack([np.eye(4), np.diag([1, np.nan, 1, 1])]),
    "expected 0 0 0 1 as the last row": np.eye(4) + np.eye(4, k=-3),
    "matrix 1 is .*, expected a rotation": np.stack([np.eye(4), np.diag([1, 1, -1, 1.0])]),
    "matrix is .*, expected a rotation": np.diag([2, 2, 2, 1.0]),
}


@pytest.mark.parametrize("message", BAD_MATRICES)
def test_what_is_no_pose_is_named(message):
    with pytest.raises(VaporTrackError, match=message):
        Poses.from_matrix(BAD_MATRICES[message])


def test_rotations_and_translations_are_as_many():
    with pytest.raises(VaporTrackError, match=r"translation has shape \(3,\), expected \(2, 3\)"):
        Poses.from_rotation([0, 0, 0], Rotation.identity(2))
    with pytest.raises(VaporTrackError, match=r"translation has shape \(2, 3\), expected \(3,\)"):
        Poses.from_quat_xyzw(np.zeros((2, 3)), [0, 0, 0, 1])


def test_a_batch_is_iterated_pose_by_pose_and_a_single_pose_is_not():
    poses = random_poses(8, 3)
    assert_same(Poses.stack(list(poses)), poses)
    with pytest.raises(TypeError, match="a single pose has no length"):
        list(poses[0])


@given(tangents, tangents)
def test_adjoint_carries_a_tangent_to_the_left(pose_tangent, tangent):
    pose = Poses.exp(pose_tangent)
    left = pose @ Poses.exp(tangent) @ pose.inverse()
    assert_same(left, Poses.exp(pose.adjoint() @ tangent), atol=1e-9)


def test_interpolation_keeps_its_ends_and_constant_speed():
    a, b = random_poses(5), random_poses(6)
    assert_same(a.interpolate(b, 0.0), a)
    assert_same(a.interpolate(b, 1.0), b)
    half = a.interpolate(b, 0.5)
    assert_same(half @ (a.inverse() @ half), b)


@pytest.mark.parametrize("angle", [0.0, 1e-8, 1e-3, 1.0, np.pi - 1e-9, np.pi])
def test_distance_is_exact_from_zero_to_half_a_turn(angle):
    other = Poses.exp(np.array([3.0, 4.0, 0, angle, 0, 0]))
    flat = Poses(other.rotation, np.array([3.0, 4.0, 0]))
    translation_m, rotation_rad = Poses.identity().distance(flat)
    assert translation_m == pytest.approx(5.0)
    assert rotation_rad == pytest.approx(angle, abs=1e-7)


def test_mean_of_a_symmetric_batch_is_its_centre():
    centre = random_poses(7)
    tangent = 0.3 * np.random.default_rng(8).standard_normal((50, 6))
    tangent[:, :3] = 0
    batch = centre @ Poses.exp(np.concatenate([tangent, -tangent]))
    assert_same(batch.mean(), centre)


def test_mean_respects_weights():
    pair = Poses.stack([random_poses(9), random_poses(10)])
    assert_same(pair.mean(np.array([1.0, 0.0])), pair[0])


BAD_QUATERNIONS = {
    r"quaternion xyzw is \[0.*\], expected a unit quaternion": [0.0, 0, 0, 0],
    r"quaternion xyzw is not finite: \[nan.*\], expected finite numbers": [np.nan, 0, 0, 1],
    r"quaternion xyzw has shape \(\), expected \(\*batch, 4\)": 5,
    "quaternion xyzw is .*, expected numbers of one shape": [[0, 0, 0, 1], [1]],
}


@pytest.mark.parametrize("message", BAD_QUATERNIONS)
def test_a_quaternion_that_is_none_is_refused_with_its_value(message):
    with pytest.raises(VaporTrackError, match=message):
        Poses.from_quat_xyzw(np.zeros(3), BAD_QUATERNIONS[message])


def test_of_many_bad_quaternions_the_first_is_named():
    quaternions = np.tile([0.0, 0, 0, 1], (1000, 1))
    quaternions[7:] = 0.0
    with pytest.raises(VaporTrackError, match=r"^quaternion xyzw 7 is \[0\.0, 0\.0, 0\.0, 0\.0\], expected a unit"):
        Poses.from_quat_xyzw(np.zeros((1000, 3)), quaternions)


def test_tangents_are_six_numbers_and_lists_do():
    assert_same(Poses.exp([[1, 2, 3, 0, 0, 0]]), Poses.from_quat_xyzw([[1, 2, 3]], [[0, 0, 0, 1]]))
    with pytest.raises(VaporTrackError, match=r"tangent has shape \(5,\), expected \(\*batch, 6\)"):
        Poses.exp(np.zeros(5))


def test_squared_distances_of_all_pairs_are_those_of_each_however_far_from_the_origin():
    a, b = random_poses(14, 5), random_poses(15, 3)
    far = np.array([1e6, -1e6, 0.0])
    metres_sq, versines = Poses(a.rotation, a.translation + far).squared_distances(
        Poses(b.rotation, b.translation + far)
    )
    translation_m, rotation_rad = Poses(a.rotation[:, None], a.translation[:, None]).distance(b)
    np.testing.assert_allclose(metres_sq, translation_m**2, atol=1e-8)
    np.testing.assert_allclose(versines, 2.0 - 2.0 * np.cos(rotation_rad), atol=1e-12)
    assert Poses.identity(2).squared_distances(Poses.identity(0))[0].shape == (2, 0)


def test_only_the_identity_is_the_identity():
    assert Poses.identity().is_identity
    assert not Poses.exp(np.array([0, 0, 0, 0, 0, 1e-12])).is_identity
    assert not Poses.exp(np.array([1e-12, 0, 0, 0, 0, 0])).is_identity
