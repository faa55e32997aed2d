"""Runs on data sets: true poses are compared with, and images that the model was trained on are said."""

import numpy as np
import pytest

from filtering.se3 import Poses
from sequences.datasets.listing import list_images
from tests.helpers.checkpoints import remembering
from tests.helpers.command_line import refuse, report_of, words_of_run
from tests.helpers.data_sets import make_7scenes
from vapor.evaluation.trained_images import said_of_trained_images
from vapor.pipeline.config import RunConfig
from vapor.pipeline.model import load_model
from vapor.pipeline.run import request_of
from vapor.track import main
from vapor.training_data.entries import open_sequences


@pytest.fixture
def scene(tmp_path):
    return make_7scenes(tmp_path / "scene", num_images=8)


def test_true_poses_of_a_data_set_are_compared_with(scene, tiny_model, tmp_path):
    for part, count in (((), 8), (("--start-s", "0.1", "--duration-s", "0.1"), 4)):
        options = ["--odometry", "none", *part]
        assert main(words_of_run(scene, tiny_model, tmp_path / "out", options)) == 0
        report = report_of(tmp_path / "out")
        assert report["frames"] == report["frames_with_true_pose"] == count
        assert "were trained on" not in " ".join(report["notices"])  # the model remembers none


def test_the_images_that_a_training_left_out_are_run_on_by_their_numbers(scene, tmp_path):
    model = remembering(list_images(scene).world_from_camera[3:], tmp_path / "model.safetensors")
    part = scene.with_name("scene@:3")
    assert main(words_of_run(part, model, tmp_path / "out", ["--odometry", "none"])) == 0
    report = report_of(tmp_path / "out")
    assert report["frames"] == report["frames_with_true_pose"] == 3
    assert not any("were trained on" in notice for notice in report["notices"])
    loaded = load_model(str(model), RunConfig())
    requests = {request_of(path, loaded, RunConfig(), None) for path in (scene, part, scene.with_name("scene@1:3"))}
    assert len(requests) == 3


def test_results_are_not_written_among_the_images_that_are_read(tiny_model, tmp_path, capsys):
    multi = make_7scenes(tmp_path / "multi", num_images=2, sequences=("seq-01", "seq-02"))
    (multi / "TestSplit.txt").write_text("sequence2\n")
    for sequence, output in (
        (multi / "TestSplit.txt", multi),
        (multi / "TestSplit.txt", multi / "seq-02"),
        (f"{multi / 'seq-01'}@0:2", multi / "seq-01"),
        (make_7scenes(tmp_path / "scene", num_images=2), tmp_path / "scene" / "seq-01"),
    ):
        words = words_of_run(sequence, tiny_model, output, ["--overwrite"])
        refuse(words, capsys, f"{output}: is read, and would be written to")


def test_a_request_depends_on_the_images_that_a_list_names(tiny_model, tmp_path):
    scene, model = make_7scenes(tmp_path / "scene", num_images=2), load_model(str(tiny_model), RunConfig())
    (split := scene / "TestSplit.txt").write_text("sequence1\n")
    before = request_of(split, model, RunConfig(), None)
    assert request_of(split, model, RunConfig(), None) == before
    with (scene / "seq-01" / "frame-000001.color.png").open("ab") as file:
        file.write(b"more")
    assert request_of(split, model, RunConfig(), None) != before


def test_a_folder_whose_name_ends_like_a_part_is_a_folder(scene, tiny_model, tmp_path):
    named = scene.rename(tmp_path / "sc@1:2")
    assert len(list(open_sequences([named])[named.name])) == 8
    assert main(words_of_run(named, tiny_model, tmp_path / "out", ["--odometry", "none"])) == 0
    assert report_of(tmp_path / "out")["frames"] == 8


def test_images_that_were_trained_on_are_said(scene, tmp_path, capsys):
    poses = list_images(scene).world_from_camera
    model = remembering(poses[3:], tmp_path / "model.safetensors")
    assert main(words_of_run(scene, model, tmp_path / "out", ["--odometry", "none"])) == 0
    said = "5 of 8 images were trained on: the model remembers images with exactly their true poses"
    assert report_of(tmp_path / "out")["notices"][0].startswith(said)
    assert said in capsys.readouterr().out
    other = ["--odometry", "none", "--duration-s", "0.07"]
    assert main(words_of_run(scene, model, tmp_path / "out", other)) == 0
    assert report_of(tmp_path / "out")["frames"] == 3
    assert not any("were trained on" in notice for notice in report_of(tmp_path / "out")["notices"])


def _remembered(poses: Poses) -> Poses:
    """Poses as a model stores them."""
    return Poses(*(each.astype(np.float32).astype(float) for each in (poses.rotation, poses.translation)))


def _said(truth: Poses, trained: Poses) -> str | None:
    return said_of_trained_images([truth[i] for i in range(len(truth))], _remembered(trained))


def test_poses_that_are_near_but_not_the_same_are_of_other_images():
    rng = np.random.default_rng(0)
    trained = Poses.exp(rng.standard_normal((20, 6)) * [100, 100, 1, 1, 1, 1])
    same = said_of_trained_images([None, *(trained[i] for i in range(20))], _remembered(trained))
    assert same is not None
    assert same.startswith("20 of 21 images were trained on")
    assert _said(trained @ Poses.exp(np.full((20, 6), 2e-5)), trained) is None
    assert said_of_trained_images([None, None], trained) is None


@pytest.mark.parametrize(("offset_m", "apart_m"), [(5.4e6, 3.0), (1e3, 5e-4), (0.0, 1e-6)])
def test_lanes_side_by_side_are_of_other_images_however_far_their_origin_is(offset_m, apart_m):
    x = np.arange(300.0)
    lanes = [np.stack([offset_m + x, np.full(300, offset_m + y), np.zeros(300)], axis=1) for y in (1.0, 1.0 + apart_m)]
    one, other = (Poses(np.tile(np.eye(3), (300, 1, 1)), lane) for lane in lanes)
    assert _said(one, one) is not None
    assert _said(one, other) is None


def test_recordings_that_begin_at_one_pose_or_stand_at_it_are_of_other_images():
    rng = np.random.default_rng(1)
    walks = [Poses.exp(np.vstack([np.zeros(6), rng.standard_normal((20, 6))])) for _ in range(2)]
    assert _said(*walks) is None
    stand = Poses.stack([walks[0][3]] * 20)
    assert _said(stand, Poses.concatenate([stand, walks[1]])) is None
