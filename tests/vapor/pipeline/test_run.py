"""What `vapor-track run` and `evaluate` write, and that it is the same twice."""

import csv
import json
import re
import shutil
from collections import Counter
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, replace
from io import StringIO
from pathlib import Path

import numpy as np
import pytest

from filtering.se3 import Poses
from filtering.storeys import Storeys
from sequences.frame import Trajectory
from sequences.odometry_fit.result import OdometryFit
from sequences.reader import SequenceReader
from sequences.recordings.bag import Bag
from sequences.recordings.messages import pose_from_message
from sequences.trajectories.tum import read_tum, write_tum
from tests.helpers.command_line import report_of
from tests.helpers.live_system import stamp
from tests.helpers.pages import entities_of
from tests.helpers.sequence_files import BEGIN_NS, Walk, rewrite
from tests.helpers.tf_files import robot, stamps
from tests.helpers.tiny_model import SMALL
from vapor.checkpoints.file_format import load_checkpoint, save_checkpoint
from vapor.observation import VaporObservationModel
from vapor.reporting.modes_file import read_mode_trajectories
from vapor.track import main

TRAJECTORIES = {
    "trajectory.tum", "smoothed.tum", "single_image.tum", "dead_reckoning.tum", "kalman.tum",
}  # fmt: skip

WITH_TRUTH = {"ground_truth.tum"}

FILES = TRAJECTORIES | {
    "estimate.mcap", "config.json", "report.html", "report.json", "manifest.json", "modes.csv",
    "status.csv",
}  # fmt: skip

METRICS = {"median_translation_m", "median_rotation_deg", "ape_rmse_m", "recall", "position_recall", "worse_than"}

METHODS = {"single_image", "dead_reckoning", "kalman", "filter", "smoothed"}


def run(sequence: Path, model: Path, output: Path, *words: str) -> int:
    return main(["run", str(sequence), "--model", str(model), "--output", str(output), *SMALL, *words])


def names(directory: Path) -> set[str]:
    return {path.name for path in directory.iterdir()}


@dataclass(frozen=True)
class Finished:
    """A run to look at: its directory, and what it printed."""

    directory: Path
    printed: str
    errors: str


@pytest.fixture(scope="module")
def finished(tiny_model: Path, walk_of_25: Path, tmp_path_factory: pytest.TempPathFactory) -> Finished:
    directory = tmp_path_factory.mktemp("runs") / "deep" / "down" / "first"
    out, err = StringIO(), StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        assert run(walk_of_25, tiny_model, directory) == 0
    return Finished(directory, out.getvalue(), err.getvalue())


# --- what a run writes ----------------------------------------------------------------------------


def test_a_run_writes_everything_and_leaves_nothing_else(finished):
    assert names(finished.directory) == FILES | WITH_TRUTH | {"recording.rrd"}
    assert names(finished.directory.parent) == {"first"}
    assert all(path.stat().st_size > 100 for path in finished.directory.iterdir())
    shown = entities_of(finished.directory / "recording.rrd")
    assert {"/world/path/smoothed", "/world/path/dead_reckoning", "/world/path/filter"} <= shown


def test_a_run_prints_its_table_and_where_things_lie_and_no_error(finished):
    for words in ("single image", "dead reckoning", "Kalman filter", "particle filter", "smoothed"):
        assert words in finished.printed
    for name in ("report.html", "recording.rrd"):
        assert str(finished.directory / name) in finished.printed
    assert re.fullmatch(r"(localizing: .+ left\n)*localizing: 25 images in \d+ s\n", finished.errors)


def test_the_report_has_exactly_the_keys_of_its_contract(finished):
    report = report_of(finished.directory)
    about = {"frames", "frames_with_true_pose", "skipped", "images", "duration_s", "odometry", "status", "particles"}
    assert set(report) == METHODS | about | {
        "smoothed_doubtful",
        "hindsight",
        "step_ms",
        "peak_rss_mb",
        "consistency",
        "storeys",
        "reliability",
        "notices",
    }
    assert set(report["consistency"]) == {"images", "wrong", "coverage", "median_nees"}
    assert report["frames"] == 25
    assert report["skipped"] == {}
    assert report["images"] == {"stated": 25, "read": 25, "used": 25, "skipped": {}}
    assert "images     25 stated, 25 read, 25 used, 0 skipped" in finished.printed
    assert set(report["step_ms"]) == {"p50", "p95"}
    assert 0 < report["step_ms"]["p50"] <= report["step_ms"]["p95"]
    assert report["peak_rss_mb"] > 50
    for method in METHODS:
        tracks = method in ("kalman", "filter", "smoothed")
        tracking = {"converged_at_s", "success", "after_convergence"} if tracks else set()
        assert set(report[method]) == METRICS | tracking
        assert set(report[method]["recall"]) == {"0.1m/10deg", "0.2m/15deg", "0.3m/20deg"}
    assert report["dead_reckoning"]["recall"]["0.1m/10deg"] == 1.0  # the odometry of the walk is exact


def test_a_run_says_how_the_belief_is_spread_over_the_storeys_of_its_model(
    finished, tiny_model, walk_of_25, tmp_path, monkeypatch
):
    assert report_of(finished.directory)["storeys"] is None  # a network with random weights knows of none
    heights = read_tum(finished.directory / "trajectory.tum").poses.translation[:, 2]
    low, high = (float(round(height, 3)) for height in (heights.min() - 2.0, heights.max() + 0.5))
    monkeypatch.setattr(VaporObservationModel, "storeys", Storeys((low, high, high + 9.0)))
    assert run(walk_of_25, tiny_model, tmp_path / "out", "--no-recording") == 0
    report = report_of(tmp_path / "out")
    storeys = report["storeys"]
    assert storeys["heights_m"] == [low, high, high + 9.0]
    assert sum(storeys["belief"]) == pytest.approx(1.0, abs=1e-5)
    assert 0.0 <= storeys["true_storey"] <= 1.0
    trajectory, truth = (read_tum(tmp_path / "out" / name).poses for name in ("trajectory.tum", "ground_truth.tum"))
    on = [np.abs(poses.translation[:, 2:] - [low, high, high + 9.0]).argmin(axis=1) for poses in (trajectory, truth)]
    assert storeys["accuracy"].keys() == METHODS
    assert storeys["accuracy"]["filter"] == pytest.approx(np.mean(on[0] == on[1]), abs=1e-6)
    assert report["filter"] == report_of(finished.directory)["filter"]


def test_every_trajectory_has_a_pose_for_every_image(finished, walk_of_25):
    stamps = [frame.time_ns for frame in SequenceReader(walk_of_25)]
    for name in TRAJECTORIES | {"ground_truth.tum"}:
        assert read_tum(finished.directory / name).times_ns.tolist() == stamps


def test_the_status_says_of_every_pose_what_is_to_be_thought_of_it(finished):
    with (finished.directory / "status.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == [
        "time",
        "status",
        "std_m",
        "std_deg",
        "unassigned",
        "log_likelihood",
        "innovation",
        "smoothed",
        *("smoothed_std_m", "smoothed_std_deg", "carried_off", "camera"),
    ]
    lines = (finished.directory / "smoothed.tum").read_text().splitlines()
    assert [row["time"] for row in rows] == [line.split()[0] for line in lines]
    shares = Counter(row["status"] for row in rows)
    said = report_of(finished.directory)["status"]
    assert {name: shares[name] / 25 for name in said} == pytest.approx(said)
    smoothed = Counter(row["smoothed"] for row in rows)
    assert smoothed.keys() <= {"fits", "doubtful", "ambiguous"}
    assert report_of(finished.directory)["smoothed_doubtful"] == smoothed["doubtful"]
    told = f"{smoothed['doubtful']} of 25 smoothed poses are doubtful: images about them do not fit (status.csv)"
    assert (told in finished.printed) == (smoothed["doubtful"] > 0)
    assert all(0.0 < float(row["std_m"]) < 1e4 and 0.0 < float(row["std_deg"]) < 1e4 for row in rows)


def test_the_best_modes_of_all_images_are_the_trajectory(finished):
    modes = read_mode_trajectories(finished.directory / "modes.csv").values()
    best = {
        time_ns: position
        for mode in modes
        for time_ns, position in zip(
            mode.trajectory.times_ns[mode.ranks == 0].tolist(),
            mode.trajectory.poses.translation[mode.ranks == 0],
            strict=True,
        )
    }
    filtered = read_tum(finished.directory / "trajectory.tum")
    positions = np.array([best[time_ns] for time_ns in filtered.times_ns.tolist()])
    np.testing.assert_allclose(positions, filtered.poses.translation, atol=1e-6)


def test_evaluate_refuses_files_that_are_not_those_of_the_run(finished, tmp_path, capsys):
    out = tmp_path / "out"
    shutil.copytree(finished.directory, out)
    with (out / "smoothed.tum").open("a") as file:
        file.write("# a note\n")
    assert main(["evaluate", str(out)]) == 1
    assert "smoothed.tum: differs from what manifest.json lists" in capsys.readouterr().err
    (out / "manifest.json").unlink()
    assert main(["evaluate", str(out)]) == 0
    assert "could not be checked" in capsys.readouterr().out


def test_the_estimate_can_be_read_back_with_the_poses_of_the_trajectory(finished):
    trajectory = read_tum(finished.directory / "trajectory.tum")
    bag = Bag(finished.directory / "estimate.mcap")
    assert {*bag.topics} == {"/estimate/pose", "/estimate/modes", "/estimate/particles", "/estimate/smoothed", "/tf"}
    messages = {topic: [raw.decode() for raw in bag.messages([topic])] for topic in bag.topics}
    assert {len(each) for each in messages.values()} == {25}
    poses = messages["/estimate/pose"]
    assert [stamp(message.header) for message in poses] == trajectory.times_ns.tolist()
    read = Poses.stack([pose_from_message(message.pose.pose) for message in poses])
    assert np.max(trajectory.poses.distance(read)) < 1e-7
    assert all(np.linalg.eigvalsh(np.reshape(message.pose.covariance, (6, 6)))[0] >= -1e-9 for message in poses)
    assert {len(message.poses) for message in messages["/estimate/particles"]} == {300}
    later = Poses.stack([pose_from_message(message.pose.pose) for message in messages["/estimate/smoothed"]])
    assert np.max(read_tum(finished.directory / "smoothed.tum").poses.distance(later)) < 1e-7
    std_m = [
        np.sqrt(np.reshape(each.pose.covariance, (6, 6))[:3, :3].trace()) for each in messages["/estimate/smoothed"]
    ]
    with (finished.directory / "status.csv").open() as file:
        widest_m = [float(row["smoothed_std_m"]) for row in csv.DictReader(file)]
    assert all(widest <= 1.001 * std + 1e-4 for widest, std in zip(widest_m, std_m, strict=True))


def test_the_configuration_tells_every_setting_as_it_was_used(finished):
    config = json.loads((finished.directory / "config.json").read_text())
    said_of_itself = {"image_source": None, "odometry": "exact, for tests", "motion": "", "no_odometry": ""}
    assert config["sequence"] == {"name": "walk.mcap", "images": 25} | said_of_itself
    assert config["model"]["name"] == "tiny.safetensors"
    assert (config["run"]["seed"], config["run"]["num_samples"], config["run"]["device"]) == (0, 60, "cpu")
    assert config["run"]["localizer"]["max_hypotheses"] == 40
    assert config["reading"]["image_topic"] == "/camera/image/compressed"
    assert config["reading"]["odometry_topic"] == "/odom"
    assert len(config["reading"]["base_from_camera"]) == 7
    assert {"python", "vapor-track", "torch", "numpy", "gtsam"} <= set(config["versions"])


def test_evaluate_finds_the_figures_of_the_report_again(finished, tmp_path, capsys):
    again = tmp_path / "again.json"
    assert main(["evaluate", str(finished.directory), "--output", str(again)]) == 0
    assert "particle filter" in capsys.readouterr().out
    figures, report = json.loads(again.read_text()), report_of(finished.directory)
    assert set(figures) == METHODS | {"frames", "frames_with_true_pose"}
    for method in METHODS:
        for shares in ("recall", "position_recall", "worse_than"):
            assert figures[method].pop(shares) == report[method].pop(shares)
        assert figures[method] == pytest.approx(report[method], abs=2e-6)


def test_evaluate_takes_other_true_poses(finished, tmp_path):
    truth = read_tum(finished.directory / "trajectory.tum")
    write_tum(tmp_path / "truth.tum", Trajectory(truth.times_ns, truth.poses))
    options = ["--ground-truth", str(tmp_path / "truth.tum"), "--output", str(tmp_path / "figures.json")]
    assert main(["evaluate", str(finished.directory), *options]) == 0
    assert json.loads((tmp_path / "figures.json").read_text())["filter"]["ape_rmse_m"] == 0.0


def test_with_a_lag_each_pose_is_also_given_by_the_images_until_then(tiny_model, walk_of_25, tmp_path):
    assert run(walk_of_25, tiny_model, tmp_path / "out", "--no-recording", "--lag", "0.5") == 0
    lagged = read_tum(tmp_path / "out" / "fixed_lag.tum")
    assert lagged.times_ns.tolist() == read_tum(tmp_path / "out" / "trajectory.tum").times_ns.tolist()
    assert "/estimate/fixed_lag" in Bag(tmp_path / "out" / "estimate.mcap").topics
    assert "fixed_lag" in report_of(tmp_path / "out")


# --- less than everything -------------------------------------------------------------------------


@pytest.mark.usefixtures("unchecked")
def test_without_true_poses_nothing_is_evaluated_and_nothing_of_an_earlier_run_stays(
    finished, tiny_model, walk_of_25, tmp_path, capsys
):
    out = tmp_path / "out"
    shutil.copytree(finished.directory, out)
    (out / "notes.txt").write_text("not a result")
    blind = rewrite(walk_of_25, tmp_path / "blind.mcap", keep=lambda topic, _: topic != "/ground_truth/pose")
    capsys.readouterr()
    assert run(blind, tiny_model, out, "--no-recording") == 1
    assert "holds notes.txt, expected an empty folder or unchanged results" in capsys.readouterr().err
    assert run(blind, tiny_model, out, "--no-recording", "--overwrite") == 0
    assert names(out) == FILES | {"notes.txt"}
    assert not METHODS & set(report_of(out))
    assert re.search(r"25 images: .*converged", capsys.readouterr().out)
    assert main(["evaluate", str(out)]) == 1
    assert "--ground-truth" in capsys.readouterr().err


def test_a_run_of_one_image_is_a_run(tiny_model, tmp_path):
    assert run(Walk(1).write(tmp_path / "one.mcap"), tiny_model, tmp_path / "out") == 0
    report = report_of(tmp_path / "out")
    assert report["frames"] == 1
    assert report["odometry"] == "recorded"
    assert set(report) & METHODS == METHODS - {"dead_reckoning"}


@pytest.mark.usefixtures("unchecked", "plain_results")
def test_options_choose_the_segment_and_leave_out_topics(tiny_model, walk_of_25, tmp_path):
    words = ["--start-s", "0.5", "--duration-s", "1", "--ground-truth-topic", "", "--no-recording"]
    assert run(walk_of_25, tiny_model, tmp_path / "out", *words) == 0
    report = report_of(tmp_path / "out")
    assert (report["frames"], report["duration_s"], report["frames_with_true_pose"]) == (11, 1.0, 0)


@pytest.mark.usefixtures("unchecked", "plain_results")
def test_true_poses_and_odometry_of_tf_are_used_and_their_jumps_said(tiny_model, tmp_path, capsys):
    at_ns = next(t for t in stamps(every_ms=90, since_ms=-39) if t > BEGIN_NS + 600_000_000)  # behind the seventh image
    out, words = tmp_path / "out", ["--ground-truth-frame", "map", "--no-recording"]
    assert run(robot(tmp_path / "a.mcap", jump_ns=at_ns), tiny_model, out, *words) == 0
    assert "true poses of tf frame map jump 1 time, first at" in capsys.readouterr().out
    reading = json.loads((out / "config.json").read_text())["reading"]
    assert (reading["ground_truth_frame"], reading["odometry_frame"], reading["poses"]) == ("map", "odom", None)
    assert len(read_tum(out / "ground_truth.tum")) == 11


@pytest.mark.usefixtures("unchecked", "plain_results")
def test_the_noise_of_odometry_is_that_of_the_calibration_unless_it_is_told_not_to(tiny_model, walk_of_25, tmp_path):
    six = (0.01,) * 6
    fit = OdometryFit(six, six, six, 30.0, 0.0, 0.1, six, six, six, 0.1, 100, 1, 10.0, 10.0, 0)
    checkpoint = load_checkpoint(tiny_model)
    calibration = replace(checkpoint.calibration, odometry=fit)
    model = tmp_path / "fitted.safetensors"
    save_checkpoint(model, replace(checkpoint, calibration=calibration), store_float16=True)
    assert run(walk_of_25, model, tmp_path / "fitted", "--no-recording", "--fitted-odometry") == 0
    assert run(walk_of_25, model, tmp_path / "stated", "--no-recording", "--no-fitted-odometry") == 0
    assert run(walk_of_25, tiny_model, tmp_path / "plain", "--no-recording") == 0
    fitted, stated, plain = (
        {name: (tmp_path / folder / name).read_bytes() for name in ("kalman.tum", "trajectory.tum")}
        for folder in ("fitted", "stated", "plain")
    )
    assert fitted["kalman.tum"] != stated["kalman.tum"]
    assert stated == plain
    config = json.loads((tmp_path / "stated" / "config.json").read_text())
    assert config["run"]["fitted_odometry"] is False
