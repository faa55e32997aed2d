"""What is kept of a training run, and what ends it."""

from dataclasses import replace

import numpy as np
import pytest

from filtering.se3 import Poses
from tests.helpers.checkout import SHARED_DATA
from tests.helpers.tiny_training import TINY, make_frames, pose, train_on_most
from vapor.checkpoints.file_format import load_checkpoint
from vapor.regressors.loss_config import LossConfig
from vapor.training.train import train, train_on
from vapor.training_data.training_set import TrainingError

DESK = SHARED_DATA / "tum_fr1/rgbd_dataset_freiburg1_xyz"


@pytest.mark.parametrize("select_by", ["log_density", "sample_recall"])
def test_the_epoch_that_is_best_on_held_out_images_is_kept(tmp_path, select_by):
    config = replace(TINY, select_by=select_by, ema_decay=0.0, epochs=5)
    result = train_on_most(make_frames(24), tmp_path / "m.safetensors", config)
    assert [figures.epoch for figures in result.history] == [1, 2, 3, 4, 5]
    figures = [getattr(v, select_by) for v in result.history]
    assert result.best is not None
    assert result.best is result.history[::-1][int(np.argmax(figures[::-1]))]  # the last of equally good ones
    stored = load_checkpoint(tmp_path / "m.safetensors").training
    assert stored["validation"]["epoch"] == result.best.epoch
    assert stored["selected_by"] == select_by


def test_box_and_prior_come_from_training_images_only(tmp_path):
    frames = make_frames(20)
    far = [replace(f, world_from_camera=Poses(pose(f).rotation, np.array([90.0, 0, 0]))) for f in frames]
    config = replace(TINY, epochs=1)
    result = train_on({"a": frames}, tmp_path / "m.safetensors", config, validation={"b": [*frames[:6], *far]})
    assert max(result.checkpoint.box.upper) < 3.0
    assert result.checkpoint.prior_poses.translation.max() < 3.0
    assert len(result.checkpoint.prior_poses) == 20
    (note,) = result.checkpoint.training["holding_out"]
    assert note.endswith(": b, images 6 to 25")  # and nothing is judged by those


def test_the_model_file_tells_where_it_came_from_without_folders(tmp_path):
    if not DESK.is_dir():
        pytest.skip(f"no posed images: {DESK} is absent")
    config = replace(TINY, epochs=1)
    reading = []
    train([f"{DESK}@0:10"], tmp_path / "m.safetensors", config, validation=[f"{DESK}@20:24"], progress=reading.append)
    training = load_checkpoint(tmp_path / "m.safetensors").training
    assert training["data"] == ["rgbd_dataset_freiburg1_xyz@0:10"]
    assert training["validation_data"] == ["rgbd_dataset_freiburg1_xyz@20:24"]
    assert training["training_images"] == training["images_seen"] == 10
    assert [p.done for p in reading if p.stage == "reading"] == list(range(1, 11))
    assert str(DESK.parent) not in str(training)


def test_a_loss_that_is_not_finite_ends_the_training(tmp_path):
    config = replace(TINY, loss=LossConfig(num_samples=8), learning_rate=1e30)
    with pytest.raises(TrainingError, match=r"loss is .* in epoch 1, step"):
        train_on({"a": make_frames(24)}, tmp_path / "m.safetensors", config)
    assert list(tmp_path.iterdir()) == []


def test_a_missing_output_folder_is_told_before_anything_is_read(tmp_path):
    def unread():
        raise AssertionError("frames were read")
        yield

    with pytest.raises(TrainingError, match=r"m\.safetensors: .*expected the folder .*absent to exist"):
        train_on({"a": unread()}, tmp_path / "absent/m.safetensors", TINY)
