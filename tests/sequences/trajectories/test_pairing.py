"""Which odometry lies between which images."""

from functools import reduce

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from filtering.motion import MotionNoise, Odometry
from filtering.se3 import Poses
from sequences.errors import SequenceError
from sequences.trajectories.interpolation import interpolate, odometry_between
from sequences.trajectories.pose_window import Motion, PoseWindow, is_jump

SECOND = 1_000_000_000


def random_walk(n: int, seed: int) -> tuple[np.ndarray, Poses, np.ndarray]:
    """Irregular stamps, poses, and a full positive definite twist covariance for each message."""
    rng = np.random.default_rng(seed)
    times_ns = np.cumsum(rng.integers(SECOND // 100, SECOND // 5, n)).astype(np.int64)
    poses = [Poses.exp(rng.normal(size=6))]
    for _ in range(n - 1):
        poses.append(poses[-1] @ Poses.exp(rng.normal(scale=0.05, size=6)))
    root = rng.normal(scale=0.1, size=(n, 6, 6))
    return times_ns, Poses.stack(poses), root @ np.swapaxes(root, 1, 2)


def assert_same(a: Poses, b: Poses, tolerance: float = 1e-9) -> None:
    np.testing.assert_allclose(a.as_matrix(), b.as_matrix(), atol=tolerance)


def test_a_pose_at_a_stamp_is_that_pose_and_halfway_is_halfway() -> None:
    times_ns = np.array([0, 10, 20], np.int64) * SECOND
    poses = Poses.exp(np.array([[0.0] * 6, [2.0, 0, 0, 0, 0, 1.0], [5.0, 1, 0, 0.3, 0, 1.0]]))
    found, covered = interpolate(times_ns, poses, np.array([0, 5, 10, 20], np.int64) * SECOND, max_gap_s=10.0)
    assert covered.all()
    assert_same(found[np.array([0, 2, 3])], poses)
    # Constant twist from the identity: half the tangent vector.
    assert_same(found[1], Poses.exp(np.array([1.0, 0, 0, 0, 0, 0.5])))


def test_times_outside_and_in_gaps_are_not_covered_but_stamps_beside_gaps_are() -> None:
    times_ns = np.array([10, 11, 20], np.int64) * SECOND
    poses = Poses.identity(3)
    query_ns = np.array([9, 10, 11, 15, 20, 21], np.int64) * SECOND
    _, covered = interpolate(times_ns, poses, query_ns, max_gap_s=1.0)
    np.testing.assert_array_equal(covered, [False, True, True, False, True, False])


@settings(max_examples=30)
@given(seed=st.integers(0, 10_000), cut=st.floats(0.1, 0.9), measured=st.integers(0, 6))
def test_increments_and_their_covariances_add_up_wherever_the_images_fall(seed: int, cut: float, measured: int) -> None:
    times_ns, poses, twists = random_walk(12, seed)
    unknown = np.arange(6) >= measured
    twists[:, unknown, unknown] = np.inf
    start, end = int(times_ns[0] * 0.3 + times_ns[1] * 0.7), int(times_ns[-2] * 0.6 + times_ns[-1] * 0.4)
    middle = int(start + cut * (end - start))
    setting = {"base_from_camera": Poses.exp(np.array([0.3, 0.2, 0.1, 1.0, -1.0, 0.5])), "motion_noise": MotionNoise()}
    whole = odometry_between(times_ns, poses, twists, start, end, **setting)
    first = odometry_between(times_ns, poses, twists, start, middle, **setting)
    both = first.then(odometry_between(times_ns, poses, twists, middle, end, **setting))
    assert_same(both.previous_from_current, whole.previous_from_current)
    scale = np.sqrt(np.outer(np.diag(whole.covariance), np.diag(whole.covariance)))
    np.testing.assert_allclose(both.covariance / scale, whole.covariance / scale, atol=1e-9)
    assert whole.duration_s == pytest.approx((end - start) * 1e-9)
    assert both.duration_s == pytest.approx(whole.duration_s)


def test_time_that_runs_backwards_is_refused() -> None:
    times_ns, poses, twists = random_walk(4, seed=2)
    setting = {"base_from_camera": Poses.identity(), "motion_noise": MotionNoise()}
    start, end = int(times_ns[2]), int(times_ns[1])
    with pytest.raises(SequenceError, match=f"from {start} ns to {end} ns, expected the end not to be before"):
        odometry_between(times_ns, poses, twists, start, end, **setting)


def test_the_covariance_is_that_of_simulated_twist_errors() -> None:
    # Precondition of the law above: the carried sum is what errors in the base frame do to the camera's increment.
    times_ns = np.arange(6, dtype=np.int64) * (SECOND // 10)
    _, poses, _ = random_walk(6, seed=3)
    base_from_camera = Poses.exp(np.array([0.5, -0.2, 0.3, 0.8, -0.4, 1.2]))
    rng = np.random.default_rng(0)
    root = rng.normal(scale=0.02, size=(6, 6))
    twist = root @ root.T
    odometry = odometry_between(
        times_ns,
        poses,
        np.broadcast_to(twist, (6, 6, 6)).copy(),
        0,
        int(times_ns[-1]),
        base_from_camera=base_from_camera,
        motion_noise=MotionNoise(),
    )
    n = 40_000
    base = Poses.identity(n)
    steps = poses[:-1].inverse() @ poses[1:]
    for step in range(5):
        noise = rng.standard_normal((n, 6)) @ root.T * 0.1
        base = base @ (steps[step] @ Poses.exp(noise))
    camera = base_from_camera.inverse() @ base @ base_from_camera
    errors = (odometry.previous_from_current.inverse() @ camera).log()
    sampled = errors.T @ errors / n
    scale = np.sqrt(np.outer(np.diag(odometry.covariance), np.diag(odometry.covariance)))
    # 40 000 samples: entries of a correlation matrix have a standard error of at most √2/200.
    np.testing.assert_allclose(sampled / scale, odometry.covariance / scale, atol=0.03)


def test_zero_covariances_leave_the_word_to_the_motion_noise() -> None:
    times_ns, poses, twists = random_walk(8, seed=5)
    noise = MotionNoise(translation_per_sqrt_m=0.2)
    end = int(times_ns[-1])
    setting = {"base_from_camera": Poses.identity(), "motion_noise": noise}
    odometry = odometry_between(times_ns, poses, np.zeros_like(twists), int(times_ns[0]), end, **setting)
    steps, seconds = poses[:-1].inverse() @ poses[1:], np.diff(times_ns) * 1e-9
    parts = [Odometry(step, noise.covariance(step, s), s) for step, s in zip(steps, seconds.tolist(), strict=True)]
    expected = reduce(Odometry.then, parts)
    assert_same(odometry.previous_from_current, expected.previous_from_current)
    np.testing.assert_allclose(odometry.covariance, expected.covariance, rtol=1e-9, atol=1e-15)


def test_axes_that_are_not_measured_get_the_motion_noise_and_the_others_keep_theirs() -> None:
    # Straight ahead along x: the adjoint mixes no known axis with another. It mixes the turn about y into z.
    times_ns = np.arange(4, dtype=np.int64) * SECOND
    poses = Poses(np.broadcast_to(np.eye(3), (4, 3, 3)).copy(), np.array([[float(i), 0.0, 0.0] for i in range(4)]))
    twist = np.diag([0.04, 0.01, np.inf, np.inf, np.inf, 0.0])
    noise = MotionNoise(translation_per_sqrt_m=0.2, rotation_per_sqrt_m=0.1)
    odometry = odometry_between(
        times_ns,
        poses,
        np.broadcast_to(twist, (4, 6, 6)).copy(),
        0,
        3 * SECOND,
        base_from_camera=Poses.identity(),
        motion_noise=noise,
    )
    stated = noise.covariance(poses[0].inverse() @ poses[3], 3.0)
    unknown = np.isinf(np.diag(twist))
    expected = np.where(unknown[:, None] & unknown, stated, np.diag([0.12, 0.03, 0, 0, 0, 0]))
    np.testing.assert_allclose(odometry.covariance, expected, rtol=1e-9, atol=1e-15)


def test_a_window_forgets_but_still_answers_for_what_follows() -> None:
    times_ns, poses, _ = random_walk(20, seed=1)
    window, whole = PoseWindow(max_gap_s=1.0), PoseWindow(max_gap_s=1.0)
    for i in range(20):
        assert window.append(int(times_ns[i]), poses[i])
        whole.append(int(times_ns[i]), poses[i])
    assert not window.append(int(times_ns[-1]), poses[0])
    previous = int(times_ns[9]) + 1000
    window.forget_before(previous)
    setting = {"base_from_camera": Poses.identity(), "motion_noise": MotionNoise()}
    end = int(times_ns[19])
    assert window.at(int(times_ns[3])) is None
    assert whole.at(int(times_ns[3])) is not None
    assert_same(
        window.odometry_between(previous, end, **setting).previous_from_current,
        whole.odometry_between(previous, end, **setting).previous_from_current,
    )


# --- jumps ------------------------------------------------------------------------------------------


def watched(metres: list[float], step_ns: int = 100_000_000) -> PoseWindow:
    """Poses on a line, ten a second."""
    window = PoseWindow(max_gap_s=0.25, watch_jumps=True)
    for i, x in enumerate(metres):
        assert window.append(i * step_ns, Poses(np.eye(3), np.array([x, 0.0, 0.0])))
    return window


@pytest.mark.parametrize(
    ("metres", "jumps"),
    [
        ([0.0, 0.0, 0.0, 0.5, 0.5, 0.5, 0.5], [3]),
        ([0.0, 0.1, 0.2, 1.3, 1.4, 1.5, 1.6], [3]),
        ([0.0, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0], [3, 4]),  # one false pose
        ([0.0, 0.0, 0.0, 0.5, 1.0, 1.0, 1.0], [3, 4]),  # a correction in two parts
        ([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5], [6]),
        ([0.0, 0.0, 0.0, 0.2, 0.4, 0.6, 0.8], []),  # setting off
        ([0.0, 2.0, 4.0, 6.0, 8.0, 10.0, 12.0], []),  # a car
        ([0.0, 0.0, 0.0, 0.09, 0.09, 0.09, 0.09], []),  # too short for one
        ([0.0, 0.5], []),  # nothing to compare with
    ],
)
def test_a_step_much_faster_than_those_around_it_is_a_jump(metres: list[float], jumps: list[int]) -> None:
    window = watched(metres)
    times = [i * 100_000_000 for i in range(len(metres))]
    assert [i for i in range(1, len(metres)) if window.jumps_at(times[i] - 1)] == jumps
    assert not any(window.jumps_at(t) for t in (*times, -5, times[-1] + 5))  # at a pose nothing is interpolated
    window.finish()
    assert window.num_jumps == len(jumps)
    assert window.first_jump_ns == (times[jumps[0]] if jumps else None)


def test_a_turn_on_the_spot_may_be_a_jump_and_a_long_step_is_a_gap() -> None:
    still, turned = Motion(0.0, 0.0, 0.1), Motion(0.0, 0.3, 0.1)
    assert is_jump([still, still, turned, still], 2)
    assert not is_jump([still, still, Motion(3.0, 0.0, 2.5), still], 2)


def test_jumps_are_counted_once_while_the_window_forgets() -> None:
    window = PoseWindow(max_gap_s=0.25, watch_jumps=True)
    for i in range(200):
        window.append(i * 100_000_000, Poses(np.eye(3), np.array([float(i // 50), 0.0, 0.0])))
        window.forget_before((i - 1) * 100_000_000)
    window.finish()
    assert (window.num_jumps, window.first_jump_ns) == (3, 5_000_000_000)


def test_neighbours_that_hardly_differ_may_be_far_apart() -> None:
    for metres, covered in ((0.04, True), (0.06, False)):
        window = PoseWindow(max_gap_s=0.1, still_gap_s=2.0)
        window.append(0, Poses.identity())
        window.append(1_900_000_000, Poses(np.eye(3), np.array([metres, 0.0, 0.0])))
        assert (window.at(950_000_000) is not None) is covered
        window.append(4_000_000_000, Poses(np.eye(3), np.array([metres, 0.0, 0.0])))
        assert window.at(3_000_000_000) is None


def test_poses_in_any_order_lie_in_a_window_as_if_they_had_come_in_theirs() -> None:
    times_ns, poses, twists = random_walk(12, seed=8)
    poses = Poses(poses.rotation, np.array(poses.translation))
    poses.translation[6:] += 30.0  # a jump
    windows = []
    for order in (range(12), [1, 0, 3, 2, 4, 8, 5, 7, 6, 11, 10, 9]):
        window = PoseWindow(10.0, watch_jumps=True)
        assert all(window.append(int(times_ns[i]), poses[i], twists[i]) for i in order)
        windows.append(window)
    ordered, shuffled = windows
    assert (shuffled.begin_ns, shuffled.end_ns) == (ordered.begin_ns, ordered.end_ns)
    setting = {"base_from_camera": Poses.identity(), "motion_noise": MotionNoise()}
    start, end = int(times_ns[1]) + 1000, int(times_ns[9]) + 1000
    expected, found = (window.odometry_between(start, end, **setting) for window in windows)
    np.testing.assert_array_equal(found.covariance, expected.covariance)
    assert_same(found.previous_from_current, expected.previous_from_current, 0.0)
    for time_ns in (int(times_ns[5]) + 1, int(times_ns[8]) + 1):
        assert shuffled.jumps_at(time_ns) == ordered.jumps_at(time_ns) == (time_ns < times_ns[6])


def test_a_pose_that_comes_after_its_time_was_asked_for_changes_nothing() -> None:
    window = PoseWindow(10.0)
    assert all(window.append(t, Poses.identity()) for t in (0, 10, 20, 40))
    window.forget_before(25)
    pose = Poses.exp(np.full(6, 0.1))
    assert not window.append(22, pose)  # before what was asked for
    assert not window.append(30, pose)  # between that and the pose that it was interpolated with
    assert not window.append(40, pose)  # there is one
    assert window.append(60, pose)
    assert window.append(50, pose)
    assert window.end_ns == 60
