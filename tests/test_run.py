"""What `vapor-track run` and `evaluate` write, that it is the same twice, and the Python API beside it."""

import json
import re
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from filtering.localizer import LocalizerConfig, ParticleLocalizer
from filtering.motion import Odometry
from filtering.se3 import Poses
from sequences.frame import Trajectory
from sequences.reader import SequenceReader
from sequences.synthesize import synthesize, write_synthetic
from sequences.tum import read_tum, write_tum
from tests.sequence_files import Walk, as_split_folder, rewrite
from tests.tiny_model import SMALL
from vapor.track import main

README = Path(__file__).parents[1] / "README.md"
TRAJECTORIES = {"trajectory.tum", "smoothed.tum", "single_image.tum", "dead_reckoning.tum", "kalman.tum"}
WITH_TRUTH = {"ground_truth.tum", "errors.png"}
FILES = TRAJECTORIES | {"estimate.mcap", "config.json", "report.json", "trajectory.png", "particles.png"}
METRICS = {"median_translation_m", "median_rotation_deg", "ape_rmse_m", "recall", "worse_than"}
METHODS = {"single_image", "dead_reckoning", "kalman", "filter", "smoothed"}


def run(sequence: Path, model: Path, output: Path, *words: str) -> int:
    return main(["run", str(sequence), "--model", str(model), "--output", str(output), *SMALL, *words])


def names(directory: Path) -> set[str]:
    return {path.name for path in directory.iterdir()}


def report_of(directory: Path) -> dict:
    return json.loads((directory / "report.json").read_text())


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


# --- what a run writes -------------------------------------------------------------------------------


def test_a_run_writes_everything_and_leaves_nothing_else(finished):
    assert names(finished.directory) == FILES | WITH_TRUTH | {"recording.rrd"}
    assert names(finished.directory.parent) == {"first"}
    assert all(path.stat().st_size > 100 for path in finished.directory.iterdir())
    for picture in finished.directory.glob("*.png"):
        assert picture.read_bytes().startswith(b"\x89PNG")
    assert (finished.directory / "recording.rrd").read_bytes().startswith(b"RRF")


def test_a_run_prints_its_table_and_where_things_lie_and_no_error(finished):
    for words in ("single image", "dead reckoning", "Kalman filter", "particle filter", "smoothed"):
        assert words in finished.printed
    for name in ("report.json", "recording.rrd", "particles.png"):
        assert str(finished.directory / name) in finished.printed
    assert finished.errors == ""


def test_the_report_has_exactly_the_keys_of_its_contract(finished):
    report = report_of(finished.directory)
    about = {"frames", "frames_with_true_pose", "skipped", "duration_s", "status", "particles"}
    assert set(report) == METHODS | about | {"step_ms", "peak_rss_mb", "consistency"}
    assert set(report["consistency"]) == {"images", "wrong", "coverage", "median_nees"}
    assert report["frames"] == 25
    assert report["skipped"] == {}
    assert set(report["step_ms"]) == {"p50", "p95"}
    assert 0 < report["step_ms"]["p50"] <= report["step_ms"]["p95"]
    assert report["peak_rss_mb"] > 50
    for method in METHODS:
        tracks = method in ("kalman", "filter", "smoothed")
        tracking = {"converged_at_s", "success", "after_convergence"} if tracks else set()
        assert set(report[method]) == METRICS | tracking
        assert set(report[method]["recall"]) == {"0.1m/10deg", "0.2m/15deg", "0.3m/20deg"}
    assert report["dead_reckoning"]["recall"]["0.1m/10deg"] == 1.0  # the odometry of the walk is exact


def test_every_trajectory_has_a_pose_for_every_image(finished, walk_of_25):
    stamps = [frame.time_ns for frame in SequenceReader(walk_of_25)]
    for name in TRAJECTORIES | {"ground_truth.tum"}:
        assert read_tum(finished.directory / name).times_ns.tolist() == stamps


def test_the_estimate_can_be_read_back_with_the_poses_of_the_trajectory(finished):
    trajectory = read_tum(finished.directory / "trajectory.tum")
    by_topic: dict[str, list] = {}
    with open(finished.directory / "estimate.mcap", "rb") as stream:
        for schema, channel, _, message in make_reader(
            stream, decoder_factories=[DecoderFactory()]
        ).iter_decoded_messages():
            assert schema is not None
            by_topic.setdefault(f"{channel.topic} {schema.name}", []).append(message)
    assert {topic: len(messages) for topic, messages in by_topic.items()} == {
        "/estimate/pose geometry_msgs/msg/PoseWithCovarianceStamped": 25,
        "/estimate/modes visualization_msgs/msg/MarkerArray": 25,
        "/estimate/particles geometry_msgs/msg/PoseArray": 25,
        "/tf tf2_msgs/msg/TFMessage": 25,
    }
    poses = by_topic["/estimate/pose geometry_msgs/msg/PoseWithCovarianceStamped"]
    assert [p.header.stamp.sec * 10**9 + p.header.stamp.nanosec for p in poses] == trajectory.times_ns.tolist()
    at = np.array([[p.pose.pose.position.x, p.pose.pose.position.y, p.pose.pose.position.z] for p in poses])
    np.testing.assert_allclose(at, trajectory.poses.translation, atol=1e-8)
    turned = [p.pose.pose.orientation for p in poses]
    read = Poses.from_quat_xyzw(at, np.array([[q.x, q.y, q.z, q.w] for q in turned]))
    assert trajectory.poses.distance(read)[1].max() < 1e-7
    assert all(np.linalg.eigvalsh(np.reshape(p.pose.covariance, (6, 6)))[0] >= -1e-9 for p in poses)
    clouds = by_topic["/estimate/particles geometry_msgs/msg/PoseArray"]
    assert {len(cloud.poses) for cloud in clouds} == {150}


def test_the_configuration_tells_every_setting_as_it_was_used(finished):
    config = json.loads((finished.directory / "config.json").read_text())
    assert config["sequence"] == {"name": "walk.mcap", "images": 25, "odometry": "exact, for tests"}
    assert config["model"]["name"] == "tiny.safetensors"
    assert (config["run"]["seed"], config["run"]["num_samples"], config["run"]["device"]) == (0, 60, "cpu")
    assert config["run"]["localizer"]["num_particles"] == 150
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
        for shares in ("recall", "worse_than"):
            assert figures[method].pop(shares) == report[method].pop(shares)
        assert figures[method] == pytest.approx(report[method], abs=2e-6)


def test_evaluate_takes_other_true_poses(finished, tmp_path):
    truth = read_tum(finished.directory / "trajectory.tum")
    write_tum(tmp_path / "truth.tum", Trajectory(truth.times_ns, truth.poses))
    options = ["--ground-truth", str(tmp_path / "truth.tum"), "--output", str(tmp_path / "figures.json")]
    assert main(["evaluate", str(finished.directory), *options]) == 0
    assert json.loads((tmp_path / "figures.json").read_text())["filter"]["ape_rmse_m"] == 0.0


# --- the same twice ----------------------------------------------------------------------------------


def test_the_same_seed_gives_the_same_bytes_and_another_seed_does_not(finished, tiny_model, walk_of_25, tmp_path):
    assert run(walk_of_25, tiny_model, tmp_path / "again") == 0
    assert run(walk_of_25, tiny_model, tmp_path / "other", "--seed", "1", "--no-recording") == 0
    for name in TRAJECTORIES | {"config.json", "estimate.mcap", "trajectory.png", "particles.png", "errors.png"}:
        assert (tmp_path / "again" / name).read_bytes() == (finished.directory / name).read_bytes(), name
    first, again, other = (report_of(d) for d in (finished.directory, tmp_path / "again", tmp_path / "other"))
    for report in (first, again, other):
        del report["step_ms"], report["peak_rss_mb"]
    assert again == first
    assert other != first
    assert (tmp_path / "other" / "trajectory.tum").read_bytes() != (tmp_path / "again" / "trajectory.tum").read_bytes()


def test_a_rosbag2_folder_gives_what_its_file_gives(finished, tiny_model, walk_of_25, tmp_path):
    folder = as_split_folder(walk_of_25, tmp_path)
    assert run(folder, tiny_model, tmp_path / "out", "--no-recording") == 0
    for name in ("trajectory.tum", "smoothed.tum"):
        assert (tmp_path / "out" / name).read_bytes() == (finished.directory / name).read_bytes()


# --- less than everything ----------------------------------------------------------------------------


def test_without_true_poses_nothing_is_judged_and_nothing_of_an_earlier_run_stays(
    tiny_model, walk_of_25, tmp_path, capsys
):
    out = tmp_path / "out"
    assert run(walk_of_25, tiny_model, out) == 0
    (out / "notes.txt").write_text("not a result")
    blind = rewrite(walk_of_25, tmp_path / "blind.mcap", keep=lambda topic, _: topic != "/ground_truth/pose")
    capsys.readouterr()
    assert run(blind, tiny_model, out, "--no-recording") == 0
    assert names(out) == FILES | {"notes.txt"}
    assert not METHODS & set(report_of(out))
    assert re.search(r"25 images: .*converged", capsys.readouterr().out)
    assert main(["evaluate", str(out)]) == 1
    assert "--ground-truth" in capsys.readouterr().err


def test_a_run_of_one_image_is_a_run(tiny_model, tmp_path):
    assert run(Walk(1).write(tmp_path / "one.mcap"), tiny_model, tmp_path / "out") == 0
    report = report_of(tmp_path / "out")
    assert report["frames"] == 1
    assert set(report) & METHODS == METHODS - {"dead_reckoning"}


def test_options_choose_the_stretch_and_leave_out_topics(tiny_model, walk_of_25, tmp_path):
    words = ["--start-s", "0.5", "--duration-s", "1", "--ground-truth-topic", "", "--no-recording"]
    assert run(walk_of_25, tiny_model, tmp_path / "out", *words) == 0
    report = report_of(tmp_path / "out")
    assert (report["frames"], report["duration_s"], report["frames_with_true_pose"]) == (11, 1.0, 0)


# --- the Python API ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Nearby:
    """A user's posterior: Gaussian in position about a point, any rotation near one; nothing of ours inherited."""

    centre: np.ndarray
    std_m: float = 0.2

    def sample(self, num_samples, *, rng):
        tangent = rng.standard_normal((num_samples, 6)) * [*[self.std_m] * 3, 0.1, 0.1, 0.1]
        moved = Poses.exp(tangent)
        return Poses(moved.rotation, self.centre + tangent[:, :3])

    def log_density(self, poses):
        far = np.sum((poses.translation - self.centre) ** 2, axis=1) / self.std_m**2
        turned = poses.distance(Poses.identity())[1] / 0.1
        return -0.5 * (far + turned**2) - 3 * np.log(2 * np.pi * self.std_m * 0.1)

    def log_likelihood(self, poses):
        return np.logaddexp(self.log_density(poses) + np.log(1000.0 * 8 * np.pi**2), 0.0)


class UsersModel:
    def observe(self, image, *, rng):
        return Nearby(np.array([image[0, 0, 0] / 10.0, 2.0, 1.5]))


def test_a_users_own_observation_model_drives_the_filter():
    localizer = ParticleLocalizer(UsersModel(), LocalizerConfig(num_particles=400), rng=np.random.default_rng(0))
    odom = Odometry(Poses.exp(np.array([0.1, 0, 0, 0, 0, 0])), np.diag([1e-4] * 6))
    for i in range(15):
        estimate = localizer.step(np.full((4, 6, 3), i, np.uint8), odom if i else None)
        best = estimate.modes[0]
        np.testing.assert_allclose(best.world_from_camera.translation, [i / 10.0, 2.0, 1.5], atol=0.15)
    assert estimate.status == "converged"
    assert best.weight > 0.9
    assert np.sqrt(best.covariance[0, 0]) < 0.2  # better than any one image


def test_the_ten_lines_of_the_readme_run(tmp_path, monkeypatch, capsys):
    blocks = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), flags=re.DOTALL)
    block = next((b for b in blocks if "ParticleLocalizer" in b), None)
    assert block is not None, "the README shows no Python block with ParticleLocalizer"
    lines = [line for line in block.splitlines() if line.strip() and not line.startswith(("import", "from"))]
    assert len(lines) <= 12
    write_synthetic(synthesize("staircase", seed=3, num_frames=6, width=80, height=60), tmp_path / "sequence.mcap")
    monkeypatch.chdir(tmp_path)
    exec(compile(block, "README.md", "exec"), {"__name__": "readme"})
