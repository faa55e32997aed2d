"""What a run makes of a robot's tilt and height (`--planar`), and of gravity by an inertial unit."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from filtering.errors import VaporTrackError
from filtering.se3 import Poses
from sequences.frame import Gravity
from sequences.trajectories.tum import read_tum
from tests.helpers.checkout import SHARED_DATA
from tests.helpers.inertial_files import IMU, inertial_messages, with_messages
from tests.helpers.planar_robot import driven
from tests.helpers.simulation import RNG, seen_at
from tests.helpers.tiny_model import SMALL
from vapor.checkpoints.file_format import load_checkpoint, load_description, save_checkpoint
from vapor.pipeline.verticals import Verticals, planar_of
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


def spoken(verticals, poses):
    """The vertical once five images have spoken."""
    return [verticals.step(seen_at(pose)) for pose in poses[:5]][-1]


def load_error(model):
    """The network's error of the tilt: that of rotation, about axes across up."""
    return float(np.mean(model.calibration.errors.typical_std[3:]))


def test_a_robots_model_gives_each_image_tilt_and_height_and_says_so(of_poses):
    poses = driven(300, rng=RNG(0))
    verticals = Verticals(of_poses(poses, poses), "auto")
    assert spoken(verticals, poses) is not None
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


def upright(poses, *, flipped=1.0):
    return [Gravity(tuple(flipped * pose.rotation.T @ [0, 0, 1]), 0.02) for pose in poses]


def test_gravity_of_a_camera_in_a_hand_is_used_with_the_models_up(of_poses):
    poses = driven(100, rng=RNG(0), tilt_std=0.2)
    verticals = Verticals(of_poses(poses, poses), "auto")
    for number, (pose, gravity) in enumerate(zip(poses, upright(poses), strict=True)):
        vertical = verticals.step(seen_at(pose), gravity)
        if number < 4:
            assert vertical is None
        else:
            assert vertical.up == gravity.up
    np.testing.assert_allclose(vertical.world_up, [0, 0, 1], atol=1e-9)
    assert vertical.heights is None
    assert not verticals.notices


@pytest.mark.parametrize(("flipped", "why"), [(-1.0, "upside down"), (1.0, "another mount")])
def test_gravity_that_is_not_that_of_the_images_is_not_used_and_said(of_poses, flipped, why):
    poses = driven(100, rng=RNG(0), tilt_std=0.2)
    turned = poses if flipped < 0 else poses @ Poses.exp(np.array([0, 0, 0, 0.8, 0, 0]))
    verticals = Verticals(of_poses(poses, poses), "auto")
    used = [
        verticals.step(seen_at(pose), gravity)
        for pose, gravity in zip(poses, upright(turned, flipped=flipped), strict=True)
    ]
    assert not any(used[10:])
    assert "gravity is off the images by" in verticals.notices[0]
    assert why in verticals.notices[0]


def test_gravity_and_a_robots_tilt_count_by_their_variances_and_the_height_is_the_robots(of_poses):
    poses = driven(300, rng=RNG(0), tilt_std=0.02)
    verticals = Verticals(of_poses(poses, poses), "auto")
    robot = spoken(verticals, poses)
    gravity = upright(poses[:1])[0]
    for _ in range(5):
        both = verticals.step(seen_at(poses[0]), gravity)
    std_rad = float(np.hypot(gravity.std_rad, 0.017))  # and of up in the map
    assert both.tilt_std_rad == pytest.approx((robot.tilt_std_rad**-2 + std_rad**-2) ** -0.5)
    assert both.heights is robot.heights
    angles = [np.arccos(np.dot(both.up, each)) for each in (robot.up, gravity.up)]
    assert angles[0] / angles[1] == pytest.approx((robot.tilt_std_rad / std_rad) ** 2, rel=0.05)


def test_of_several_cameras_the_one_that_is_localized_says_whether_it_fits(of_poses):
    poses = driven(100, rng=RNG(0))
    verticals = Verticals(of_poses(poses, poses), "auto")
    wrong = Poses.exp(np.array([0, 0, 0, 1.0, 0, 0]))
    for pose in poses:
        used = verticals.step(seen_at(pose))
        also = verticals.step(seen_at(pose @ wrong), is_localized=False)
    assert used is not None
    assert also is not None
    assert "planar robot" in verticals.notices[0]
    assert not verticals.notices[0].startswith("not")


def test_gravity_that_contradicts_a_robots_tilt_is_not_averaged_with_it(of_poses):
    poses = driven(100, rng=RNG(0))
    verticals = Verticals(of_poses(poses, poses), "yes")
    robot = verticals.step(seen_at(poses[0]))
    for pose, gravity in zip(poses[:20], upright(poses[:20], flipped=-1.0), strict=True):
        assert verticals.step(seen_at(pose), gravity).up == robot.up


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


def test_gravity_of_a_recording_corrects_a_run_and_leaves_one_without_it_as_it_was(tiny_model, walk_of_25, tmp_path):
    imu = with_messages(walk_of_25, tmp_path / "imu.mcap", IMU, "sensor_msgs/Imu", inertial_messages(seconds=2.6))
    with_it = run(imu, tiny_model, tmp_path / "with")
    without, plain = (
        run(imu, tiny_model, tmp_path / "without", "--imu-topic", ""),
        run(walk_of_25, tiny_model, tmp_path / "plain"),
    )
    assert without["trajectory.tum"] == plain["trajectory.tum"]
    assert with_it["trajectory.tum"] != plain["trajectory.tum"]
