"""Metrics of a trajectory against the truth, in the map's frame."""

import numpy as np
import pytest

from filtering.errors import VaporTrackError
from filtering.motion import Odometry
from filtering.se3 import Poses
from sequences.frame import Trajectory
from sequences.trajectories.tum import write_tum
from tests.helpers.simulated_run import true_walk
from vapor.commands.evaluate import evaluate_directory
from vapor.evaluation.consistency import evaluate_consistency
from vapor.evaluation.trajectory import associate, convergence_s, evaluate_trajectory
from vapor.tracking.follow import dead_reckoning

S = 1_000_000_000


def walk(count: int = 100, *, step_ns: int = S // 10, start_ns: int = 5 * S) -> Trajectory:
    return Trajectory(start_ns + step_ns * np.arange(count), true_walk(count))


def shifted(truth: Trajectory, metres: np.ndarray, degrees: np.ndarray) -> Trajectory:
    tangent = np.zeros((len(truth), 6))
    tangent[:, 0], tangent[:, 4] = metres, np.radians(degrees)
    moved = Poses(truth.poses.rotation, truth.poses.translation + np.eye(3)[0] * metres[:, None])
    tangent[:, 0] = 0.0
    return Trajectory(truth.times_ns, moved @ Poses.exp(tangent))


def test_the_truth_itself_has_no_error_and_converges_at_once():
    metrics = evaluate_trajectory(walk(), walk(), tracking=True)
    assert metrics == {
        "median_translation_m": 0.0,
        "median_rotation_deg": pytest.approx(0.0, abs=1e-5),
        "ape_rmse_m": 0.0,
        "recall": {"0.1m/10deg": 1.0, "0.2m/15deg": 1.0, "0.3m/20deg": 1.0},
        "position_recall": {"1m": 1.0, "3m": 1.0, "5m": 1.0},
        "worse_than": {"0.1m": 0.0, "0.25m": 0.0, "0.5m": 0.0},
        "converged_at_s": 0.0,
        "success": True,
        "after_convergence": {"images": 100, "recall": {"0.1m/10deg": 1.0, "0.2m/15deg": 1.0, "0.3m/20deg": 1.0}},
    }


def test_recall_after_convergence_leaves_out_what_was_before():
    metres = np.full(100, 0.05)
    metres[:30], metres[60:62] = 5.0, 0.15
    metrics = evaluate_trajectory(shifted(walk(), metres, np.zeros(100)), walk(), tracking=True)
    assert metrics["after_convergence"]["images"] == 70
    assert metrics["after_convergence"]["recall"] == pytest.approx(
        {"0.1m/10deg": 68 / 70, "0.2m/15deg": 1.0, "0.3m/20deg": 1.0}
    )
    never = evaluate_trajectory(shifted(walk(), np.full(100, 5.0), np.zeros(100)), walk(), tracking=True)
    assert never["after_convergence"] is None


def test_known_errors_give_known_medians_rmse_and_recalls():
    truth = walk(5)
    estimate = shifted(truth, np.array([0.05, 0.15, 0.24, 0.05, 3.0]), np.array([1.0, 12.0, 18.0, 40.0, 1.0]))
    metrics = evaluate_trajectory(estimate, truth, tracking=False)
    assert metrics["median_translation_m"] == pytest.approx(0.15)
    assert metrics["median_rotation_deg"] == pytest.approx(12.0)
    assert metrics["ape_rmse_m"] == pytest.approx(np.sqrt((2 * 0.05**2 + 0.15**2 + 0.24**2 + 9.0) / 5))
    assert metrics["recall"] == pytest.approx({"0.1m/10deg": 0.2, "0.2m/15deg": 0.4, "0.3m/20deg": 0.6})
    assert metrics["worse_than"] == pytest.approx({"0.1m": 0.6, "0.25m": 0.2, "0.5m": 0.2})
    assert metrics["position_recall"] == pytest.approx({"1m": 0.8, "3m": 1.0, "5m": 1.0})


def test_the_translation_error_agrees_with_evo():
    metrics = pytest.importorskip("evo.core.metrics", reason="evo is not installed (extra `evo`)")
    from evo.core.trajectory import PoseTrajectory3D

    rng = np.random.default_rng(0)
    truth = walk()
    estimate = shifted(truth, rng.normal(0.0, 0.5, 100), rng.normal(0.0, 20.0, 100))
    theirs = [
        PoseTrajectory3D(poses_se3=list(trajectory.poses.as_matrix()), timestamps=trajectory.times_ns / 1e9)
        for trajectory in (truth, estimate)
    ]
    translation = metrics.APE(metrics.PoseRelation.translation_part)
    translation.process_data(tuple(theirs))
    rotation = metrics.APE(metrics.PoseRelation.rotation_angle_deg)
    rotation.process_data(tuple(theirs))
    ours = evaluate_trajectory(estimate, truth, tracking=False)
    assert ours["ape_rmse_m"] == pytest.approx(translation.get_statistic(metrics.StatisticsType.rmse), rel=1e-9)
    assert ours["median_translation_m"] == pytest.approx(translation.get_statistic(metrics.StatisticsType.median))
    assert ours["median_rotation_deg"] == pytest.approx(rotation.get_statistic(metrics.StatisticsType.median))


# --- convergence ---------------------------------------------------------------------------------------


def naive_convergence(times_ns: np.ndarray, right: np.ndarray) -> float | None:
    for i in range(len(right)):
        early = (times_ns[i] - times_ns[0]) < 0.8 * (times_ns[-1] - times_ns[0])
        if right[i] and early and right[i:].mean() >= 0.95:
            return (times_ns[i] - times_ns[0]) / 1e9
    return None


def test_convergence_agrees_with_its_definition_written_out():
    rng = np.random.default_rng(1)
    answers = []
    for _ in range(300):
        count = int(rng.integers(2, 80))
        times_ns = np.cumsum(rng.integers(1, S, count))
        right = (np.arange(count) > rng.uniform(0, count)) ^ (rng.random(count) < 0.03)
        answers.append(convergence_s(times_ns, right))
        assert answers[-1] == naive_convergence(times_ns, right)
    assert 50 < sum(answer is None for answer in answers) < 250


def test_being_right_only_in_the_last_fifth_is_no_convergence():
    times_ns = np.arange(101) * S
    assert convergence_s(times_ns, np.arange(101) >= 79) == 79.0
    assert convergence_s(times_ns, np.arange(101) >= 80) is None
    assert convergence_s(times_ns[:1], np.array([True])) is None


# --- association --------------------------------------------------------------------------------------


def test_true_poses_are_interpolated_but_in_a_gap_and_outside():
    truth = Trajectory(np.array([0, S // 5, 2 * S]), true_walk(3))
    found, poses = associate(np.array([-1, S // 10, S // 2, 2 * S, 2 * S + 1]), truth)
    assert found.tolist() == [False, True, False, True, False]
    halfway = truth.poses[0].interpolate(truth.poses[1], 0.5)
    assert np.allclose(poses.as_matrix(), [halfway.as_matrix(), truth.poses[2].as_matrix()], atol=1e-12)


def test_images_without_true_pose_are_left_out():
    estimate = shifted(walk(100), np.r_[np.zeros(50), np.full(50, 9.0)], np.zeros(100))
    truth = Trajectory(walk(100).times_ns[:50], walk(100).poses[:50])
    assert evaluate_trajectory(estimate, truth, tracking=False)["ape_rmse_m"] == 0.0


def test_trajectories_that_do_not_overlap_are_refused_with_both_spans():
    with pytest.raises(VaporTrackError, match=r"5\.000 s to 14\.900 s.*100\.000 s to 109\.900 s"):
        evaluate_trajectory(walk(), walk(start_ns=100 * S), tracking=False)


def test_a_pose_that_is_not_finite_is_refused_with_its_time():
    bad = walk()
    bad.poses.translation[3, 1] = np.nan
    with pytest.raises(VaporTrackError, match=r"estimated pose at 5\.300000 s is not finite"):
        evaluate_trajectory(bad, walk(), tracking=False)


# --- dead reckoning -------------------------------------------------------------------------------------


def test_errors_drawn_from_the_stated_covariance_are_consistent_and_from_a_wider_one_are_not():
    truth = walk(4000)
    factor = np.diag([0.1, 0.02, 0.05, 0.01, 0.03, 0.02])
    factor[1, 0], factor[4, 2] = 0.04, 0.02
    error = np.random.default_rng(0).standard_normal((4000, 6)) @ factor.T
    covariance = np.broadcast_to(factor @ factor.T, (4000, 6, 6))
    figures = {}
    for scale in (1.0, 2.0):
        best = Trajectory(truth.times_ns, truth.poses @ Poses.exp(-scale * error))
        figures[scale] = evaluate_consistency(best, covariance, np.full(4000, np.inf), np.ones(4000, bool), truth)
    assert figures[1.0]["images"] == 4000
    beyond = (np.linalg.norm(Poses.exp(-error).translation, axis=1) > 0.3).mean()  # none turned by 20 degrees
    assert 0.0 < figures[1.0]["wrong"] == pytest.approx(beyond, abs=1e-12)
    assert figures[1.0]["coverage"] == pytest.approx({"50%": 0.5, "90%": 0.9, "95%": 0.95}, abs=0.03)
    assert figures[1.0]["median_nees"] == pytest.approx(5.35, abs=0.3)
    assert figures[2.0]["coverage"]["95%"] < 0.6
    assert figures[2.0]["median_nees"] == pytest.approx(4 * 5.35, rel=0.06)


def test_consistency_counts_only_images_that_are_said_to_be_converged():
    truth = walk(10)
    converged = np.arange(10) >= 6
    off = np.where(np.arange(10) % 2 == 0, 0.6, 0.0)
    estimate = shifted(truth, off, np.zeros(10))
    covariance = np.broadcast_to(0.01 * np.eye(6), (10, 6, 6))
    figures = evaluate_consistency(estimate, covariance, np.full(10, np.inf), converged, truth)
    assert figures == {
        "images": 4,
        "wrong": 0.5,
        "coverage": {"50%": 0.5, "90%": 0.5, "95%": 0.5},
        "median_nees": pytest.approx(18.0),
    }
    nothing = evaluate_consistency(estimate, covariance, np.full(10, np.inf), np.zeros(10, bool), truth)
    assert nothing == {"images": 0, "wrong": None, "coverage": None, "median_nees": None}


def test_dead_reckoning_with_perfect_odometry_is_the_truth():
    truth = true_walk(50)
    steps = [Odometry(truth[i - 1].inverse() @ truth[i], np.eye(6), 0.1) for i in range(1, 50)]
    poses = dead_reckoning(truth[0], [None, *steps])
    assert np.allclose(poses.as_matrix(), truth.as_matrix(), atol=1e-9)


def test_dead_reckoning_stays_where_odometry_is_missing():
    poses = dead_reckoning(Poses.identity(), [None, None, None])
    assert np.array_equal(poses.as_matrix(), Poses.identity(3).as_matrix())


# --- directories ----------------------------------------------------------------------------------------


def test_a_run_directory_is_evaluated_from_its_files(tmp_path):
    truth = walk()
    write_tum(tmp_path / "ground_truth.tum", truth)
    write_tum(tmp_path / "trajectory.tum", shifted(truth, np.r_[np.full(30, 3.0), np.full(70, 0.05)], np.zeros(100)))
    write_tum(tmp_path / "single_image.tum", shifted(truth, np.full(100, 0.25), np.zeros(100)))
    report, _ = evaluate_directory(tmp_path)
    assert list(report) == ["frames", "frames_with_true_pose", "single_image", "filter"]
    assert report["filter"]["converged_at_s"] == pytest.approx(3.0)
    assert report["filter"]["recall"]["0.1m/10deg"] == pytest.approx(0.7)
    assert report["single_image"]["median_translation_m"] == pytest.approx(0.25, abs=1e-6)


def test_another_ground_truth_may_be_given(tmp_path):
    (tmp_path / "run").mkdir()
    write_tum(tmp_path / "run" / "trajectory.tum", walk())
    write_tum(tmp_path / "truth.tum", Trajectory(walk().times_ns[:80], walk().poses[:80]))
    report, _ = evaluate_directory(tmp_path / "run", tmp_path / "truth.tum")
    assert (report["frames"], report["frames_with_true_pose"]) == (100, 80)


def test_missing_files_and_foreign_truth_are_refused_by_name(tmp_path):
    with pytest.raises(VaporTrackError, match=r"nowhere: no such directory"):
        evaluate_directory(tmp_path / "nowhere")
    with pytest.raises(VaporTrackError, match=r"no trajectory\.tum in it"):
        evaluate_directory(tmp_path)
    write_tum(tmp_path / "trajectory.tum", walk())
    with pytest.raises(VaporTrackError, match=r"ground_truth\.tum: no such file.*--ground-truth"):
        evaluate_directory(tmp_path)
    with pytest.raises(VaporTrackError, match=r"other\.tum: no such file"):
        evaluate_directory(tmp_path, tmp_path / "other.tum")
    write_tum(tmp_path / "ground_truth.tum", walk(start_ns=1000 * S))
    with pytest.raises(VaporTrackError, match=r"against .*ground_truth\.tum: no estimate has a true pose"):
        evaluate_directory(tmp_path)


def test_true_poses_by_another_clock_and_as_euroc_has_them(tmp_path):
    turns = 0.03 * np.random.default_rng(0).standard_normal((40, 3)).repeat(10, axis=0)
    poses = Poses.exp(np.cumsum(np.concatenate([np.full((400, 3), 0.01), turns], axis=1), axis=0))
    times_ns = 10**18 + np.arange(400) * 50_000_000
    write_tum(tmp_path / "trajectory.tum", Trajectory(times_ns, poses))
    rows = zip(times_ns - 300_000_000, poses.translation, poses.as_quat_xyzw(), strict=True)
    lines = [",".join(map(str, [t, *v.tolist(), q[3], *q[:3].tolist()])) for t, v, q in rows]
    (tmp_path / "data.csv").write_text("\n".join(lines))
    report, notices = evaluate_directory(tmp_path, tmp_path / "data.csv")
    assert "0.30 s are to be added" in notices[0]
    found, notices = evaluate_directory(tmp_path, tmp_path / "data.csv", "auto")
    key = "median_translation_m"
    assert found["filter"][key] < 0.01 < report["filter"][key]
    assert "time offset 0.300" in notices[0]
