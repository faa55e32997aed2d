"""Other people's estimators as observation models: sequences without images, the model, and `vapor-track fuse`."""

import itertools
import json
from pathlib import Path

import numpy as np
import pytest

from filtering.errors import VaporTrackError
from filtering.localizer import ParticleLocalizer
from filtering.motion import Odometry
from filtering.posterior import LikelihoodModel, PosteriorSamples
from filtering.se3 import Poses
from sequences.errors import SequenceError
from sequences.estimates import EstimateOptions, EstimateSequence
from sequences.frame import Trajectory
from sequences.odometry import OdometryNoise
from sequences.pose_files import read_poses
from sequences.tum import read_tum, write_tum
from tests.pose_text import FRAMES, moved, noisy, walk, write_named
from vapor.fuse import EstimateConfig, EstimateModel, estimate_modes, likelihood_of
from vapor.track import main

BACK = EstimateOptions(direction="world-to-camera")
EXACT = OdometryNoise(0.0, 0.0, 0.0, 30.0, 0.0, 0.0)
SMALL = ["--localizer.num-particles", "300", "--no-recording"]


@pytest.fixture
def truth(tmp_path: Path) -> Path:
    return write_named(tmp_path / "truth.txt", walk(), world_to_camera=True)


def file_of(path: Path, poses: dict[str, Poses]) -> Path:
    return write_named(path, poses, world_to_camera=True, extra="")


# --- sequences -----------------------------------------------------------------------------------------


def test_each_sequence_starts_without_odometry_and_exact_odometry_leads_to_the_next_frame(tmp_path, truth):
    options = EstimateOptions(direction="world-to-camera", noise=EXACT)
    sequence = EstimateSequence([truth], simulate_odometry_from=truth, options=options)
    frames = list(sequence)
    assert len(frames) == sequence.num_images == 2 * FRAMES
    assert sequence.interval_s == pytest.approx(1 / 30)
    assert [i for i, frame in enumerate(frames) if frame.odometry is None] == [0, FRAMES]
    assert frames[FRAMES].time_ns - frames[FRAMES - 1].time_ns == 1_000_000_000
    assert frames[0].image.size == 0
    for before, after in itertools.pairwise(frames):
        np.testing.assert_allclose(after.estimates[0], after.world_from_camera.as_matrix(), atol=1e-8)
        if after.odometry is not None:
            led = before.world_from_camera @ after.odometry.previous_from_current
            np.testing.assert_allclose(led.as_matrix(), after.world_from_camera.as_matrix(), atol=1e-7)


def test_a_file_may_lack_frames_and_odometry_reaches_across_those_that_all_lack(tmp_path, truth):
    names = list(walk())
    first = file_of(tmp_path / "a.txt", {name: walk()[name] for name in names if name not in names[10:15]})
    second = file_of(tmp_path / "b.txt", {name: walk()[name] for name in names[12:]})
    known = write_named(tmp_path / "known.txt", {n: walk()[n] for n in names[:50]}, world_to_camera=True)
    sequence = EstimateSequence(
        [first, second], simulate_odometry_from=truth, ground_truth=known,
        options=EstimateOptions(direction="world-to-camera", noise=EXACT),
    )  # fmt: skip
    frames = list(sequence)
    present = np.isfinite([frame.estimates[:, 0, 0] for frame in frames])
    assert len(frames) == len(names) - 2
    assert present[:10].tolist() == [[True, False]] * 10
    assert present[10:13].tolist() == [[False, True]] * 3
    assert present[13:].all()
    assert sequence.skipped == {"no estimate": 2}
    assert sum(frame.world_from_camera is not None for frame in frames) == 48
    led = frames[9].world_from_camera @ frames[10].odometry.previous_from_current
    np.testing.assert_allclose(led.as_matrix(), frames[10].world_from_camera.as_matrix(), atol=1e-7)
    one, three = (np.trace(frames[i].odometry.covariance) for i in (1, 10))  # exact, so the motion noise speaks
    assert 3 * one < three < 9 * one


def test_frames_that_odometry_does_not_cover_are_counted(tmp_path, truth):
    short = file_of(tmp_path / "short.txt", {name: walk()[name] for name in list(walk())[:20]})
    sequence = EstimateSequence([truth], odometry=short, ground_truth=truth, options=BACK)
    assert len(list(sequence)) == 20
    assert sequence.skipped == {"odometry does not cover": 2 * FRAMES - 20}
    assert sequence.odometry_description == "recorded: short.txt"


def test_what_contradicts_itself_is_refused(tmp_path, truth):
    timed = tmp_path / "timed.tum"
    write_tum(timed, Trajectory(np.arange(3) * 10**9, Poses.identity(3)))
    with pytest.raises(SequenceError, match="needs odometry"):
        EstimateSequence([truth], options=BACK)
    with pytest.raises(SequenceError, match="needs odometry"):
        EstimateSequence([truth], odometry=truth, simulate_odometry_from=truth, options=BACK)
    with pytest.raises(SequenceError, match=r"truth\.txt: frames by names, but those of .*timed\.tum by stamps"):
        EstimateSequence([timed], odometry=truth, options=EstimateOptions(direction="camera-to-world"))
    with pytest.raises(SequenceError, match="at least one"):
        EstimateSequence([], odometry=truth)
    with pytest.raises(SequenceError, match="rate_hz is 0"):
        EstimateOptions(rate_hz=0.0)


# --- the observation model -----------------------------------------------------------------------------


def test_the_posterior_of_estimates_is_their_mixture_of_narrow_and_wide_kernels():
    """At an estimate far from the others: Gaussian densities in six dimensions, each with its weight."""
    poses = Poses.exp(np.array([[0.3, -0.2, 0.1, 0.4, 0.5, -0.6], [30.0, 0, 0, 0, 0, 0], [0, 60.0, 0, 0, 0, 0]]))
    std_m, std_rad, share, spread = np.array([0.05, 0.1, 0.2]), np.array([0.02, 0.01, 0.03]), 0.2, 4.0
    posterior = PosteriorSamples.from_estimates(
        poses, std_m, std_rad, outlier_share=share, outlier_spread=spread, likelihood=LikelihoodModel()
    )
    peak = 1 / (3 * (2 * np.pi) ** 3 * std_m**3 * std_rad**3)
    expected = (1 - share) * peak + share * peak / spread**6
    np.testing.assert_allclose(np.exp(posterior.log_density(poses)), expected, rtol=0.01)
    drawn = posterior.sample(20_000, rng=np.random.default_rng(0))
    distance_m = drawn.distance(poses[0])[0]
    near = distance_m < 5.0
    assert near.mean() == pytest.approx(1 / 3, abs=0.02)
    assert np.sqrt(np.mean(distance_m[near] ** 2) / 3) == pytest.approx(0.05 * np.sqrt(0.8 + 0.2 * 16), rel=0.1)
    assert np.median(distance_m[near]) < 0.1
    with pytest.raises(VaporTrackError, match="at least one centre"):
        PosteriorSamples.from_estimates(
            Poses.identity(0), 0.1, 0.1, outlier_share=0.1, outlier_spread=2.0, likelihood=LikelihoodModel()
        )
    with pytest.raises(VaporTrackError, match="outlier share 1"):
        PosteriorSamples.from_estimates(
            poses, 0.1, 0.1, outlier_share=1.0, outlier_spread=2.0, likelihood=LikelihoodModel()
        )


def test_the_likelihood_is_relative_to_a_flat_prior_over_the_scene(tmp_path):
    """Estimates over 3 × 2 × 1 m: the prior is one over their box with its margin, times 8π²; L is 1 far away."""
    corners = np.stack(np.meshgrid([0.0, 3.0], [0.0, 2.0], [0.0, 1.0]), -1).reshape(-1, 3)
    path = file_of(
        tmp_path / "corners.txt", {f"frame-{i}.png": Poses(np.eye(3), corner) for i, corner in enumerate(corners)}
    )
    likelihood = likelihood_of([read_poses(path, "world-to-camera")], EstimateConfig(), interval_s=0.1)
    assert 1 / likelihood.prior_floor == pytest.approx(4 * 3 * 2 * 8 * np.pi**2, rel=0.01)
    assert likelihood.temper == pytest.approx(0.1)
    model = EstimateModel(1, EstimateConfig(std_m=(0.1,), std_deg=(5.0,)), likelihood)
    posterior = model.observe(np.eye(4)[None], rng=np.random.default_rng(0))
    here, far = posterior.log_likelihood(Poses.stack([Poses.identity(), moved(Poses.identity(), 50.0)]))
    assert far == pytest.approx(0.0, abs=1e-9)
    density = float(np.exp(posterior.log_density(Poses.identity(1))[0]))
    assert here == pytest.approx(0.1 * np.log(0.95 * density / likelihood.prior_floor / 0.05 + 1), rel=1e-6)


def test_the_model_leaves_out_methods_without_an_estimate_and_drives_the_filter_itself():
    matrices = np.stack([np.full((4, 4), np.nan), np.eye(4), moved(Poses.identity(), 0.02).as_matrix()])
    model = EstimateModel(3, EstimateConfig(std_m=(0.9, 0.05, 0.05)), LikelihoodModel(temper=0.5))
    posterior = model.observe(matrices, rng=np.random.default_rng(0))
    modes = estimate_modes(posterior)
    assert len(modes) == 2
    assert {round(float(mode.world_from_camera.translation[0]), 6) for mode in modes} == {0.0, 0.02}
    np.testing.assert_allclose(np.diag(modes[0].covariance), [0.05**2] * 3 + [np.radians(1.0) ** 2] * 3)
    localizer = ParticleLocalizer(model, rng=np.random.default_rng(0))
    still = Odometry(Poses.identity(), np.diag([1e-6] * 6))
    for odometry in (None, *[still] * 5):
        estimate = localizer.step(matrices, odometry)
    assert np.linalg.norm(estimate.modes[0].world_from_camera.translation - [0.01, 0, 0]) < 0.03
    with pytest.raises(VaporTrackError, match="at least one centre"):
        model.observe(np.full((3, 4, 4), np.nan), rng=np.random.default_rng(0))
    with pytest.raises(VaporTrackError, match="std_m has 2 values, expected one, or one for each of 3"):
        EstimateModel(3, EstimateConfig(std_m=(0.1, 0.2)), LikelihoodModel())
    with pytest.raises(VaporTrackError, match="std_deg is 0"):
        EstimateConfig(std_deg=(0.0,))


# --- the command ---------------------------------------------------------------------------------------


def test_the_command_bridges_a_run_of_wrong_estimates(tmp_path, truth, capsys):
    """Estimates 3 cm off, but for twelve images in a row that put the camera 0.6 m away; a second method lacks some."""
    poses = walk()
    names = list(poses)
    wrong = set(names[25:37])
    first = {n: moved(p, 0.6) if n in wrong else p for n, p in noisy(poses, 0.02, 0.01, 1).items()}
    second = {n: p for n, p in first.items() if n not in names[90:100]}
    output = tmp_path / "result"
    words = ["fuse", str(file_of(tmp_path / "one.txt", first)), str(file_of(tmp_path / "two.txt", second))]
    words += ["--simulate-odometry", str(truth), "--direction", "world-to-camera", "--output", str(output)]
    assert main([*words, *SMALL, "--std-m", "0.03", "0.04"]) == 0
    assert "worse than" in capsys.readouterr().out
    report = json.loads((output / "report.json").read_text())
    assert report["frames"] == report["frames_with_true_pose"] == 2 * FRAMES
    assert report["single_image"]["worse_than"] == pytest.approx({"0.1m": 0.1, "0.25m": 0.1, "0.5m": 0.1}, abs=0.02)
    assert report["filter"]["worse_than"]["0.25m"] == 0.0
    assert report["filter"]["median_translation_m"] < 0.06
    assert report["dead_reckoning"]["median_translation_m"] < 0.05  # it starts anew with the second sequence
    config = json.loads((output / "config.json").read_text())
    assert config["odometry"].startswith("simulated from truth.txt: scale 0.02, ")
    assert config["odometry"].endswith(", seed 0")
    assert config["trust"]["std_m"] == [0.03, 0.04]
    assert config["estimates"] == [{"name": "one.txt", "frames": 120}, {"name": "two.txt", "frames": 110}]
    assert config["likelihood"]["temper"] == pytest.approx(1 / 30)
    assert len(read_tum(output / "trajectory.tum")) == 2 * FRAMES
    written = {path.name for path in output.iterdir()}
    assert written >= {"smoothed.tum", "kalman.tum", "single_image.tum", "dead_reckoning.tum", "ground_truth.tum",
                       "estimate.mcap", "trajectory.png", "particles.png", "errors.png"}  # fmt: skip
    before = (output / "trajectory.tum").read_bytes()
    assert main([*words, *SMALL, "--std-m", "0.03", "0.04"]) == 0
    assert (output / "trajectory.tum").read_bytes() == before


def test_tum_trajectories_with_recorded_odometry_and_no_true_poses(tmp_path, capsys):
    poses = Poses.stack(list(walk().values())[:FRAMES])
    times_ns = 10**18 + np.arange(FRAMES) * 50_000_000
    write_tum(tmp_path / "estimate.tum", Trajectory(times_ns, poses))
    elsewhere = Poses.exp(np.array([9.0, 8.0, 7.0, 0.5, 0.6, 0.7]))
    write_tum(tmp_path / "odometry.tum", Trajectory(times_ns[5:], (elsewhere @ poses)[5:]))
    words = ["fuse", str(tmp_path / "estimate.tum"), "--odometry", str(tmp_path / "odometry.tum")]
    assert main([*words, "--output", str(tmp_path / "result"), *SMALL[:2]]) == 0  # with a recording, without images
    report = json.loads((tmp_path / "result" / "report.json").read_text())
    assert report["skipped"] == {"odometry does not cover": 5}
    assert report["frames_with_true_pose"] == 0
    assert "filter" not in report
    assert (tmp_path / "result" / "recording.rrd").stat().st_size > 0
    trajectory = read_tum(tmp_path / "result" / "trajectory.tum")
    assert trajectory.times_ns.tolist() == times_ns[5:].tolist()
    assert np.median(trajectory.poses.distance(poses[5:])[0]) < 0.03


def test_what_cannot_be_used_is_one_line_and_leaves_nothing(tmp_path, truth, capsys):
    bad = tmp_path / "bad.txt"
    bad.write_text("seq-2/frame-000000.color.png 0 0 0 0 0 0 0\n")
    output = tmp_path / "result"
    words = ["fuse", str(bad), "--simulate-odometry", str(truth), "--output", str(output)]
    assert main([*words, "--direction", "world-to-camera"]) == 1
    error = capsys.readouterr().err
    assert error.startswith("vapor-track fuse: ")
    assert "bad.txt:1: quaternion" in error
    assert error.count("\n") == 1
    assert main(words) == 1
    assert "expected their direction" in capsys.readouterr().err
    with pytest.raises(SystemExit) as stop:
        main([*words, "--odometry", str(truth)])
    assert stop.value.code == 2
    assert "either --odometry FILE or --simulate-odometry FILE" in capsys.readouterr().err
    assert not output.exists()


def test_real_estimates_of_a_staircase_have_no_tail_left(shared_data: Path, tmp_path: Path):
    """The 150 frames of 7-Scenes stairs around hloc's longest run of wrong estimates."""
    folder = shared_data / "7scenes_stairs"
    lines = (folder / "estimates" / "stairs_hloc.txt").read_text().splitlines()
    kept = [line for line in lines if "seq-01/frame-000200" <= line.split(".")[0] < "seq-01/frame-000350"]
    (tmp_path / "hloc.txt").write_text("\n".join(kept))
    words = ["fuse", str(tmp_path / "hloc.txt"), "--simulate-odometry", str(folder / "stairs_test.txt")]
    words += ["--direction", "world-to-camera", "--output", str(tmp_path / "result"), *SMALL]
    assert main(words) == 0
    report = json.loads((tmp_path / "result" / "report.json").read_text())
    assert report["frames"] == 150
    assert report["skipped"] == {"no estimate": 850}
    assert report["single_image"]["worse_than"]["0.25m"] > 0.3
    assert report["filter"]["worse_than"]["0.25m"] < 0.02
