"""Training that was interrupted goes on, to the same weights."""

from dataclasses import replace

import numpy as np
import pytest

from filtering.se3 import Poses
from tests.helpers.tiny_training import TINY, Interrupted, interrupt_at, make_frames, pose, same_weights, train_on_most
from vapor.tensor_files import CheckpointError
from vapor.training import state as saving
from vapor.training.state import state_path
from vapor.training.train import train_on

# --- resume ---------------------------------------------------------------------------------------


def test_an_interrupted_training_ends_with_the_same_weights_as_an_uninterrupted_one(tmp_path, monkeypatch):
    monkeypatch.setattr(saving, "_SELDOM", 0.0)
    frames, config = make_frames(24), replace(TINY, network=replace(TINY.network, backbone="resnet18-half"))
    whole = train_on_most(frames, tmp_path / "whole.safetensors", config)
    assert whole.best is whole.history[-1]  # so that the last weights are compared
    output = tmp_path / "m.safetensors"
    with pytest.raises(Interrupted):  # 18 training images are two steps an epoch: in the middle of the third
        train_on_most(frames, output, config, progress=interrupt_at(5))
    assert not output.exists()
    assert state_path(output).exists()
    steps = []
    resumed = train_on_most(frames, output, config, progress=lambda p: steps.append((p.stage, p.done)))
    assert [done for stage, done in steps if stage == "training"] == [5, 6, 7, 8]
    assert same_weights(resumed.checkpoint, whole.checkpoint)
    assert resumed.history == whole.history
    assert resumed.images_seen == whole.images_seen
    assert resumed.seconds > 0.0
    assert not state_path(output).exists()
    anew = train_on_most(frames, tmp_path / "other.safetensors", replace(TINY, seed=1))
    assert not same_weights(anew.checkpoint, whole.checkpoint)


@pytest.mark.usefixtures("unchecked")
def test_short_epochs_are_not_all_saved_but_the_first_and_the_last_are(tmp_path, monkeypatch):
    clock, saved = iter([0.0, 1.0, 2.0, 50.0, 51.0, 52.0, 53.0, 54.0]), []  # begin, end, and begins until the next
    monkeypatch.setattr(saving, "perf_counter", lambda: next(clock))
    monkeypatch.setattr(saving, "save_state", lambda path, state, identity: saved.append(state))
    keeper = saving.Saving(tmp_path / "state", {})
    for epoch in range(5):
        keeper.save(epoch, last=epoch == 4)
    assert saved == [0, 3, 4]


# --- as much as there is time for, and everything in the end --------------------------------------


def test_an_interrupted_training_of_another_configuration_is_not_continued(tmp_path):
    output = tmp_path / "m.safetensors"
    with pytest.raises(Interrupted):
        train_on_most(make_frames(24), output, TINY, progress=interrupt_at(3))
    with pytest.raises(CheckpointError, match=r"m\.training\.safetensors: .*differs in epochs"):
        train_on_most(make_frames(24), output, replace(TINY, epochs=5))
    with pytest.raises(CheckpointError, match="differs in images, poses"):
        train_on_most(make_frames(40), output, TINY)
    shift = Poses.exp(np.array([0.0, 0.0, 0.1, 0.0, 0.0, 0.0]))
    moved = [replace(frame, world_from_camera=pose(frame) @ shift) for frame in make_frames(24)]
    with pytest.raises(CheckpointError, match="differs in poses, expected"):
        train_on_most(moved, output, TINY)
    result = train_on_most(make_frames(24), output, replace(TINY, epochs=1, resume=False))
    assert len(result.history) == 1


@pytest.mark.parametrize("content", [b"garbage", b""])
def test_a_damaged_training_state_is_refused_by_name(tmp_path, content):
    state_path(tmp_path / "m.safetensors").write_bytes(content)
    with pytest.raises(CheckpointError, match=r"m\.training\.safetensors: cannot be read"):
        train_on({"a": make_frames(24)}, tmp_path / "m.safetensors", TINY)
