"""Other people's estimators as observation models: sequences without images, the model, and `vapor-track fuse`."""

import itertools
import json
from dataclasses import replace

import numpy as np
import pytest

from filtering.errors import VaporTrackError
from filtering.localizer import ParticleLocalizer
from filtering.motion import Odometry
from filtering.se3 import Poses
from sequences.errors import SequenceError
from sequences.estimates.sequence import EstimateOptions, EstimateSequence
from sequences.frame import Trajectory
from sequences.odometry import OdometryNoise
from sequences.trajectories.tum import read_tum, write_tum
from tests.helpers.pose_files import FRAMES, file_of, hypotheses, moved, noisy, walk, write_named
from tests.helpers.simulation import ERRORS
from vapor.commands.evaluate import evaluate_directory
from vapor.pipeline.fuse import EstimateConfig, EstimateModel, noise_of
from vapor.track import main
from vapor.tracking.methods import FILES

BACK = EstimateOptions(direction="world-to-camera")
EXACT = OdometryNoise(0.0, 0.0, 0.0, 30.0, 0.0, 0.0)
SMALL = ["--localizer.max-hypotheses", "60", "--no-recording"]


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
        np.testing.assert_allclose(
            after.estimates["world_from_camera"][0], after.world_from_camera.as_matrix(), atol=1e-8
        )
        if after.odometry is not None:
            led = before.world_from_camera @ after.odometry.previous_from_current
            np.testing.assert_allclose(led.as_matrix(), after.world_from_camera.as_matrix(), atol=1e-7)


@pytest.mark.usefixtures("unchecked")
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
    present = np.array([np.isin([0, 1], frame.estimates["file"]) for frame in frames])
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


def test_files_in_millimetres_are_read_as_metres(tmp_path, truth):
    large = {name: Poses(pose.rotation, 1000.0 * pose.translation) for name, pose in walk().items()}
    path = write_named(tmp_path / "large.txt", large, world_to_camera=True)
    options = EstimateOptions(direction="world-to-camera", noise=EXACT)
    metres = EstimateSequence([truth], simulate_odometry_from=truth, options=options)
    converted = EstimateSequence([path], simulate_odometry_from=path, options=replace(options, unit_m=0.001))
    for one, other in zip(metres, converted, strict=True):
        poses = (each.estimates["world_from_camera"] for each in (one, other))
        np.testing.assert_allclose(*poses, atol=1e-5)  # as many digits as the text has
        np.testing.assert_allclose(one.world_from_camera.as_matrix(), other.world_from_camera.as_matrix(), atol=1e-5)


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
    with pytest.raises(SequenceError, match="unit_m is 0"):
        EstimateOptions(unit_m=0.0)


def test_names_that_do_not_match_are_told_of_both_files(tmp_path, truth):
    other = file_of(tmp_path / "other.txt", {f"walk/{i}.png": pose for i, pose in enumerate(walk().values())})
    with pytest.raises(SequenceError, match=r"other.txt has 120 names such as 'walk/0', .*truth.txt has 120 names"):
        EstimateSequence([truth, other], odometry=truth, options=BACK)


def test_each_file_has_a_clock_of_its_own_though_some_stamps_coincide(tmp_path):
    turns = 0.03 * np.random.default_rng(0).standard_normal((40, 3)).repeat(10, axis=0)
    poses = Poses.exp(np.cumsum(np.concatenate([np.full((400, 3), 0.01), turns], axis=1), axis=0))
    times_ns = 10**18 + np.arange(400) * 50_000_000
    for name, late_ns in (("odometry", 0), ("exact", 0), ("late", 300_000_000)):  # of six frames
        write_tum(tmp_path / f"{name}.tum", Trajectory(times_ns + late_ns, poses))
    files = [tmp_path / "exact.tum", tmp_path / "late.tum"]
    told = EstimateSequence(files, odometry=tmp_path / "odometry.tum", options=EstimateOptions())
    (notice,) = told.notices
    assert "late.tum: by its rotation the clock differs: -0.30 s" in notice
    found = EstimateSequence(files, odometry=tmp_path / "odometry.tum", options=EstimateOptions(time_offset_s="auto"))
    assert ["time offset -0.300" in each for each in found.notices] == [False, True]


def test_columns_of_no_file_are_refused(tmp_path):
    with pytest.raises(SequenceError, match="--ground-truth-columns without --ground-truth"):
        EstimateSequence(
            [tmp_path / "a.txt"],
            odometry=tmp_path / "b.txt",
            options=EstimateOptions(ground_truth_columns="time tx ty tz qx qy qz qw"),
        )
    with pytest.raises(SequenceError, match="--odometry-columns: columns: 'x' in 'x'"):
        EstimateOptions(odometry_columns="x")
    with pytest.raises(VaporTrackError, match="--columns without --ground-truth"):
        evaluate_directory(tmp_path, columns="time tx ty tz qx qy qz qw")


@pytest.mark.parametrize("form", ["cam0/{0}{1:09d}.png", "rgb/{0}.{1:09d}.png"])
def test_clocks_that_differ_are_told_and_the_offset_is_found_also_of_stamps_as_names(tmp_path, form):
    turns = 0.03 * np.random.default_rng(0).standard_normal((40, 3)).repeat(10, axis=0)
    poses = Poses.exp(np.cumsum(np.concatenate([np.full((400, 3), 0.01), turns], axis=1), axis=0))
    times_ns = 1_500_000_000 * 10**9 + np.arange(400) * 50_000_000
    write_tum(tmp_path / "odometry.tum", Trajectory(times_ns, poses))
    names = [form.format(*divmod(int(time) - 300_000_000, 10**9)) for time in times_ns]
    named = file_of(tmp_path / "named.txt", dict(zip(names, (poses[i] for i in range(400)), strict=True)))

    def sequence(offset):
        options = replace(BACK, time_offset_s=offset)
        return EstimateSequence([named], odometry=tmp_path / "odometry.tum", options=options)

    assert "the clock differs: 0.30 s are to be added" in sequence(0.0).notices[0]
    assert not sequence(0.3).notices
    assert "time offset 0.300" in (found := sequence("auto")).notices[0]
    assert abs(next(iter(found)).time_ns - times_ns[0]) < 60_000_000


# --- the observation model -----------------------------------------------------------------------------


def test_how_estimates_err_follows_from_what_is_stated_and_where_they_are(tmp_path):
    """Estimates over 3 × 2 × 1 m: poses are spread over their box with its margin, and all rotations."""
    corners = np.stack(np.meshgrid([0.0, 3.0], [0.0, 2.0], [0.0, 1.0]), -1).reshape(-1, 3)
    names = [f"frame-{i}.png" for i in range(len(corners))]
    path = file_of(tmp_path / "corners.txt", {n: Poses(np.eye(3), c) for n, c in zip(names, corners, strict=True)})
    path_of = {n: Poses(np.eye(3), np.array([0.1 * i, 0, 0])) for i, n in enumerate(names)}
    motion = file_of(tmp_path / "motion.txt", path_of)  # 0.1 m in a thirtieth of a second
    sequence = EstimateSequence([path], odometry=motion, options=BACK)
    trust = EstimateConfig(
        std_m=(0.1,), std_deg=(5.0,), degrees_of_freedom=3.0, outlier_probability=0.2, independent_after_s=0.5
    )
    noise = noise_of(sequence, trust)
    margin = 0.2 * np.sqrt(3**2 + 2**2 + 1)
    volume = np.prod(np.array([3, 2, 1]) + margin) * 8 * np.pi**2
    assert noise.log_clutter_density == pytest.approx(-np.log(volume), rel=0.01)
    assert noise.typical_std == pytest.approx([0.1] * 3 + [np.radians(5.0)] * 3)
    assert (noise.degrees_of_freedom, noise.outlier_probability, noise.constant_fraction) == (3.0, 0.2, 0.0)
    assert noise.length_m == pytest.approx(0.5 * 3.0, rel=1e-6)
    still = file_of(tmp_path / "still.txt", dict.fromkeys(names, Poses.identity()))
    assert noise_of(EstimateSequence([path], odometry=still, options=BACK), trust).length_m == 0.1


def test_the_model_leaves_out_methods_without_an_estimate_and_drives_the_filter_itself():
    seen = hypotheses((1, 1.0, Poses.identity()), (2, 1.0, moved(Poses.identity(), 0.02)))
    model = EstimateModel(3, EstimateConfig(std_m=(0.9, 0.05, 0.1)), ERRORS)
    posterior = model.observe(seen, rng=np.random.default_rng(0))
    assert posterior.noise == ERRORS
    assert posterior.weights.tolist() == [0.5, 0.5]
    assert posterior.means.translation[:, 0].tolist() == [0.0, 0.02]
    for covariance, std_m in zip(posterior.covariances, (0.05, 0.1), strict=True):
        np.testing.assert_allclose(np.diag(covariance), [std_m**2] * 3 + [np.radians(1.0) ** 2] * 3)
    localizer = ParticleLocalizer(model, rng=np.random.default_rng(0))
    still = Odometry(Poses.identity(), np.diag([1e-6] * 6), 0.1)
    for odometry in (None, *[still] * 5):
        estimate = localizer.step(seen, odometry)
    assert np.linalg.norm(estimate.modes[0].world_from_camera.translation - [0.01, 0, 0]) < 0.03
    with pytest.raises(VaporTrackError, match="no estimate, expected at least one"):
        model.observe(hypotheses(), rng=np.random.default_rng(0))
    with pytest.raises(VaporTrackError, match="std_m has 2 values, expected one, or one for each of 3"):
        EstimateModel(3, EstimateConfig(std_m=(0.1, 0.2)), ERRORS)
    for wrong in (
        {"std_deg": (0.0,)},
        {"degrees_of_freedom": 0.5},
        {"outlier_weight": -1.0},
        {"outlier_probability": 1.0},
        {"independent_after_s": 0.0},
    ):
        with pytest.raises(VaporTrackError, match=f"{next(iter(wrong))} is "):
            EstimateConfig(**wrong)


def test_estimates_that_come_twice_are_no_camera_that_froze():
    """A method that looks up the nearest picture gives the pose of the same one for several frames."""
    model = EstimateModel(1, EstimateConfig(), ERRORS)
    localizer = ParticleLocalizer(model, rng=np.random.default_rng(0))
    for _ in range(2):
        assert not localizer.observe(hypotheses((0, 1.0, Poses.identity()))).is_uninformative


# --- the command ---------------------------------------------------------------------------------------


@pytest.mark.usefixtures("unchecked")
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
    out = capsys.readouterr().out
    assert "worse than" in out
    assert "images     120 stated, 120 read, 120 used, 0 skipped" in out
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
    assert config["estimates"] == [
        {"name": "one.txt", "frames": 120, "hypotheses": 120},
        {"name": "two.txt", "frames": 110, "hypotheses": 110},
    ]
    assert config["trust"]["degrees_of_freedom"] == 4.0
    assert config["errors"]["radius_m"] == pytest.approx(0.035)
    assert config["errors"]["outlier_probability"] == 0.1
    assert len(read_tum(output / "trajectory.tum")) == 2 * FRAMES
    written = {path.name for path in output.iterdir()}
    assert written >= ({*FILES.values()} - {FILES["fixed_lag"], FILES["gaussian_sum"]}) | {
        "ground_truth.tum",
        "estimate.mcap",
        "report.html",
    }
    before = (output / "trajectory.tum").read_bytes()
    assert main([*words, *SMALL, "--std-m", "0.03", "0.04"]) == 0
    assert (output / "trajectory.tum").read_bytes() == before


@pytest.mark.usefixtures("unchecked")
def test_another_sequence_starts_anew_however_much_the_first_one_said(tmp_path, truth):
    """The second one begins with an estimate that is 0.6 m off: nothing of the first one corrects it."""
    poses = walk()
    names = list(poses)
    first = noisy(poses, 0.02, 0.01, 1)
    first[names[FRAMES]] = moved(poses[names[FRAMES]], 0.6)
    words = ["fuse", str(file_of(tmp_path / "one.txt", first)), "--simulate-odometry", str(truth)]
    words += ["--direction", "world-to-camera", "--output", str(tmp_path / "result"), *SMALL]
    assert main(words) == 0
    trajectory = read_tum(tmp_path / "result" / "trajectory.tum")
    given = Poses.stack([first[name] for name in names])
    distance_m, _ = trajectory.poses.distance(given)
    assert distance_m[FRAMES] < 1e-6
    assert np.median(distance_m[1:FRAMES]) > 0.01
    config = json.loads((tmp_path / "result" / "config.json").read_text())
    assert config["run"]["localizer"]["gap"]["action"] == "forget"


@pytest.mark.usefixtures("unchecked", "plain_results")
def test_estimates_that_odometry_does_not_cover_count_and_frames_without_an_estimate_do_not(tmp_path, truth, capsys):
    names, output = list(walk()), tmp_path / "result"

    def fused(estimated: list[str], covered: list[str]) -> int:
        one = file_of(tmp_path / "one.txt", {name: walk()[name] for name in estimated})
        odometry = file_of(tmp_path / "odometry.txt", {name: walk()[name] for name in covered})
        words = ["fuse", str(one), "--odometry", str(odometry), "--ground-truth", str(truth)]
        return main([*words, "--direction", "world-to-camera", "--output", str(output), *SMALL])

    assert fused(names[:5], names) == 0  # few of the walk, and all that were estimated
    out = capsys.readouterr().out
    assert "images     120 stated, 120 read, 5 used, 115 skipped" in out
    assert "  skipped 115: no estimate" in out
    assert "Only" not in out

    assert fused(names[:100], names[:20]) == 0
    out = capsys.readouterr().out
    assert "images     120 stated, 120 read, 20 used, 100 skipped" in out
    assert out.splitlines()[-1] == "Only 20 of 100 images were used: 40 were skipped: after odometry ends."
    assert json.loads((output / "report.json").read_text())["images"] == {
        "stated": 120,
        "read": 120,
        "used": 20,
        "skipped": {"no estimate": 20, "after odometry ends": 40, "no odometry of its sequence": 40},
    }

    assert fused(names[:100], names[:8]) == 1
    assert "one.txt: Only 8 of 100 images were used" in capsys.readouterr().err


def test_tum_trajectories_with_recorded_odometry_and_no_true_poses(tmp_path, capsys):
    poses = Poses.stack(list(walk().values())[:FRAMES])
    times_ns = 10**18 + np.arange(FRAMES) * 50_000_000
    write_tum(tmp_path / "estimate.tum", Trajectory(times_ns, poses))
    elsewhere = Poses.exp(np.array([9.0, 8.0, 7.0, 0.5, 0.6, 0.7]))
    write_tum(tmp_path / "odometry.tum", Trajectory(times_ns[5:], (elsewhere @ poses)[5:]))
    words = ["fuse", str(tmp_path / "estimate.tum"), "--odometry", str(tmp_path / "odometry.tum")]
    assert main([*words, "--output", str(tmp_path / "result"), *SMALL[:2]]) == 0  # with a recording, without images
    report = json.loads((tmp_path / "result" / "report.json").read_text())
    assert report["skipped"] == {"before odometry begins": 5}
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
