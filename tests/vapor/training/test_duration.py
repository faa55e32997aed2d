"""As much training as there is time for, and on everything in the end."""

from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.checks import no_checks
from tests.helpers.full import full
from tests.helpers.tiny_training import TINY, Interrupted, make_frames, same_weights, train_on_most, walks
from vapor.training.presets import PRESETS
from vapor.training.train import train_on
from vapor.training.trainer import Plan

EVERYTHING = replace(TINY, calibrate=False, finish=0.5)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A training on everything in the end, and all that it told on the way."""
    told = []
    with no_checks():
        return train_on(walks(), tmp_path_factory.mktemp("w") / "m.safetensors", EVERYTHING, progress=told.append), told


@pytest.mark.usefixtures("unchecked")
def test_a_model_that_was_judged_learns_from_what_was_held_out(finished, tmp_path):
    result, told = finished
    stages = [p.stage for p in told if p.epoch]
    assert stages == ["training"] * 4 * 9 + ["training on everything"] * 2 * 12  # 72 and 96 images
    assert [p.done for p in told if p.epoch] == [*range(1, 37), *range(1, 25)]
    assert {(p.stage, p.epochs, p.total) for p in told if p.epoch} == {
        ("training", 4, 36),
        ("training on everything", 2, 24),
    }
    assert [p.epoch for p in told if p.epoch] == [*np.repeat(range(1, 5), 9), *np.repeat(range(1, 3), 12)]
    assert [p.epoch for p in result.history] == [1, 2, 3, 4]
    assert result.checkpoint.training["training_images"] == 96
    assert result.checkpoint.training["images_seen"] == result.images_seen == 4 * 72 + 2 * 96
    without = train_on(walks(), tmp_path / "n.safetensors", replace(EVERYTHING, finish=0.0))
    assert (without.history, without.images_seen) == (result.history, 4 * 72)
    assert not same_weights(result.checkpoint, without.checkpoint)


@full
def test_held_out_data_that_were_given_are_never_learned_from(tmp_path):
    parts = walks()
    held_out = {"d": parts.pop("d")}
    result = train_on(parts, tmp_path / "m.safetensors", EVERYTHING, validation=held_out)
    assert result.checkpoint.training["training_images"] == 72
    assert result.images_seen == 4 * 72


@full
@pytest.mark.usefixtures("unchecked")
def test_interrupted_before_and_after_it_was_judged_a_training_ends_with_the_same_weights(finished, tmp_path):
    for stage, step in (("training", 20), ("training on everything", 14)):

        def progress(p, stage=stage, step=step):
            if p.stage == stage and p.done == step:
                raise Interrupted

        with pytest.raises(Interrupted):
            train_on(walks(), tmp_path / "m.safetensors", EVERYTHING, progress=progress)
    assert same_weights(train_on(walks(), tmp_path / "m.safetensors", EVERYTHING).checkpoint, finished[0].checkpoint)


@full
@pytest.mark.usefixtures("unchecked")
def test_epochs_that_are_not_given_fit_into_the_hours(tmp_path, monkeypatch):
    now = iter(np.arange(0.0, 1e6, 0.1))  # as if every step took so long, and nothing else any time
    monkeypatch.setattr("vapor.training.trainer.perf_counter", lambda: float(next(now)))
    config = replace(EVERYTHING, epochs=None, hours=8.0 / 3600)
    found = train_on(walks(), tmp_path / "m.safetensors", config)
    seconds = 0.1 / 8 * found.images_seen
    assert 4.8 < seconds < 8.0  # judging takes the rest
    assert found.checkpoint.training["config"]["epochs"] == len(found.history) * (found.history[1].epoch - 1)
    assert train_on(walks(), tmp_path / "n.safetensors", replace(config, hours=1e-9)).history[-1].epoch == 4


def test_given_hours_images_are_larger_but_not_than_the_camera_s():
    auto = PRESETS["auto"]
    sizes = [
        (network.image_width, network.image_height)
        for config in (auto, replace(auto, hours=2.0), replace(auto, hours=2.0, epochs=5), replace(auto, hours=0.9))
        for network in (config.network_for(640, 480),)
    ]
    assert sizes == [(128, 96), (224, 168), (128, 96), (128, 96)]
    small = replace(auto, hours=2.0).network_for(160, 120)
    assert (small.image_width, small.image_height) == (160, 120)


def test_the_network_sees_the_camera_s_aspect_with_as_many_pixels(tmp_path):
    config = replace(TINY, aspect="camera", epochs=1)
    network = train_on_most(make_frames(24), tmp_path / "m.safetensors", config).checkpoint.network
    assert (network.image_width, network.image_height, network.shortest_edge) == (40, 32, 36)  # images are 48 x 36


@pytest.mark.usefixtures("unchecked")
def test_how_long_all_epochs_will_take_is_told_before_the_first_one(tmp_path):
    told = []
    config = replace(TINY, epochs=None, hours=1e-9, calibrate=False, finish=0.0)
    result = train_on(walks(), tmp_path / "m.safetensors", config, progress=told.append)
    planned, *later = [each for each in told if each.left_s is not None]
    assert planned.epochs == len(result.history) == 4
    assert planned.left_s > 0.0
    assert not any(each.epoch for each in told[: told.index(planned)])
    assert later == [each for each in told if each.epoch]
    assert later[-1].left_s == pytest.approx(0.0, abs=1e-9)
    assert result.evaluated == 24


@pytest.mark.filterwarnings("error")
def test_the_time_of_fewer_images_than_a_batch_is_planned_too(tmp_path):
    told = []
    config = replace(TINY, epochs=None, batch_size=64, most_epochs=1, calibrate=False)
    train_on({"a": make_frames(10)}, tmp_path / "m.safetensors", config, progress=told.append)
    planned = next(each for each in told if each.left_s is not None)
    assert 0.0 < planned.left_s < 60.0


def test_the_time_left_is_by_the_plan_as_fast_as_the_epochs_so_far():
    planned = Plan(3, (8.0, 4.0, 4.0, 2.0))  # the first epoch extracts features, which takes as long as the rest
    assert planned.seconds == 18.0
    assert planned.left_s(0, 0.5, 0.0) == 12.0
    assert planned.left_s(1, 0.0, 16.0) == pytest.approx(16.0)
    assert planned.left_s(3, 0.5, 16.0) == 1.0
    assert planned.left_s(3, 1.0, 16.0) == 0.0
