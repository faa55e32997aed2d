"""`--planar`: which models know a robot's tilt and height, and what a run makes of it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from filtering.errors import VaporTrackError
from filtering.se3 import Poses
from sequences.trajectories.tum import read_tum
from tests.helpers.checkout import SHARED_DATA
from tests.helpers.planar_robot import driven
from tests.helpers.simulation import RNG, seen_at
from tests.helpers.tiny_model import SMALL
from vapor.checkpoints.file_format import load_checkpoint, load_description, save_checkpoint
from vapor.pipeline.planar import Verticals, planar_of
from vapor.track import main


@pytest.fixture
def of_poses(tiny_model):
    def model(poses, memory=None):
        return replace(load_description(tiny_model), prior_poses=poses, memory_poses=memory)

    return model


def test_remembered_training_poses_count_as_they_are_and_samples_of_a_network_with_its_errors(of_poses):
    poses = driven(300, rng=RNG(0))
    true, sampled = planar_of(of_poses(poses[:5], poses)), planar_of(of_poses(poses))
    error = load_error(of_poses(poses))
    assert true.is_robot
    assert np.degrees(true.tilt_std_rad) < 0.7
    assert sampled.tilt_std_rad == pytest.approx(np.hypot(true.tilt_std_rad, error), rel=0.02)


def load_error(model):
    """The network's error of the tilt: that of rotation, about axes across up."""
    return float(np.mean(model.calibration.errors.typical_std[3:]))


def test_a_robots_model_gives_each_image_tilt_and_height_and_says_so(of_poses):
    poses = driven(300, rng=RNG(0))
    verticals = Verticals(of_poses(poses, poses), "auto")
    assert verticals.step(seen_at(poses[0])) is not None
    assert "planar robot" in verticals.notices[0]
    assert Verticals(of_poses(poses, poses), "no").step(seen_at(poses[0])) is None


def test_a_model_of_somebody_who_walked_gives_none_unless_it_is_said_to_be_planar(of_poses):
    poses = driven(300, rng=RNG(0), tilt_std=0.06)
    model = of_poses(poses, poses)
    assert Verticals(model, "auto").step(seen_at(poses[0])) is None
    assert not Verticals(model, "auto").notices
    vertical = Verticals(model, "yes").step(seen_at(poses[0]))
    assert np.degrees(vertical.tilt_std_rad) == pytest.approx(np.degrees(0.06), rel=0.2)


def test_a_camera_carried_by_hand_through_a_robots_map_is_let_go_of_and_reported(of_poses):
    poses = driven(300, rng=RNG(0))
    verticals = Verticals(of_poses(poses, poses), "auto")
    for pose in driven(50, rng=RNG(1), tilt_std=0.25):
        verticals.step(seen_at(pose))
    assert "not a planar robot" in verticals.notices[0]
    always = Verticals(of_poses(poses, poses), "yes")
    assert all(always.step(seen_at(pose)) is not None for pose in driven(50, rng=RNG(1), tilt_std=0.25))


def test_planar_yes_needs_training_poses(of_poses):
    with pytest.raises(VaporTrackError, match="5 training poses"):
        Verticals(of_poses(driven(5, rng=RNG(0))), "yes")


@pytest.mark.skipif(not SHARED_DATA.is_dir(), reason="recorded data is absent: ../shared/data beside the checkout")
@pytest.mark.parametrize("sequence", ["xyz", "rpy"])
def test_a_hand_held_recording_of_a_desk_is_no_robots(of_poses, sequence):
    poses = read_tum(SHARED_DATA / "tum_fr1" / f"rgbd_dataset_freiburg1_{sequence}" / "groundtruth.txt").poses[::10]
    assert not planar_of(of_poses(poses, poses)).is_robot


def run(sequence: Path, model: Path, output: Path, *words: str) -> dict[str, bytes]:
    assert main(["run", str(sequence), "--model", str(model), "--output", str(output), *SMALL, *words]) == 0
    return {path.name: path.read_bytes() for path in output.glob("*.tum")}


def test_auto_changes_nothing_of_a_hand_held_walk(tiny_model, walk_of_25, tmp_path, capsys):
    auto, no = (run(walk_of_25, tiny_model, tmp_path / use, "--planar", use) for use in ("auto", "no"))
    assert auto == no
    assert "planar" not in capsys.readouterr().out


def test_a_run_with_a_robots_model_is_corrected_in_tilt_and_height(tiny_model, walk_of_25, tmp_path, capsys):
    checkpoint = load_checkpoint(tiny_model)
    poses = checkpoint.prior_poses
    level = driven(300, rng=RNG(0), tilt_std=1e-3)
    level = Poses(level.rotation, np.resize(poses.translation, (300, 3)) * [1, 1, 0] + [0, 0, 1.0])
    noise = replace(checkpoint.calibration.errors, typical_std=(0.01,) * 3 + (0.005,) * 3)
    robot = replace(checkpoint, prior_poses=level, calibration=replace(checkpoint.calibration, errors=noise))
    save_checkpoint(tmp_path / "robot.safetensors", robot)
    known, unknown = (
        run(walk_of_25, tmp_path / "robot.safetensors", tmp_path / use, "--planar", use) for use in ("yes", "no")
    )
    assert "planar robot: tilt (within" in capsys.readouterr().out
    assert all(known[name] != unknown[name] for name in ("trajectory.tum", "smoothed.tum", "kalman.tum"))
