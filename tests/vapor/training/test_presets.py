"""Schedules, presets and settings of training."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from filtering.errors import VaporTrackError
from tests.helpers.tiny_training import TINY, make_frames, train_on_most
from vapor.checkpoints.calibration import Calibration
from vapor.regressors.loss_config import LossConfig
from vapor.training import epoch as batches
from vapor.training.augment_config import AugmentConfig
from vapor.training.config import TrainConfig
from vapor.training.epoch import uses_bfloat16
from vapor.training.presets import PRESETS
from vapor.training.schedule import first_epoch_of_size, image_size, learning_rate, samples_per_image, step_cost


def test_the_papers_rate_decays_by_a_factor_every_n_epochs_ten_times():
    config = PRESETS["paper-7scenes"]
    rates = [learning_rate(config, epoch * 7 + step, 7) for epoch in range(120) for step in range(7)]
    expected = [1e-4 * 0.8 ** min(epoch // 10, 10) for epoch in range(120) for _ in range(7)]
    np.testing.assert_allclose(rates, expected)


def test_one_cycle_rises_to_the_peak_and_falls_to_nothing():
    config = TrainConfig(epochs=10, warmup=0.2, learning_rate=1e-3)
    rates = np.array([learning_rate(config, step, 10) for step in range(100)])
    assert (np.diff(rates[:20]) > 0).all()
    assert (np.diff(rates[20:]) < 0).all()
    assert rates.max() == pytest.approx(1e-3, rel=0.01)
    assert rates[0] < 1e-5
    assert rates[-1] < 1e-6


def test_samples_grow_from_the_winners_to_all_of_them_and_by_default_do_not():
    config = TrainConfig(loss=LossConfig(alpha=0.05, num_samples=400), epochs=10, ewta_fraction=0.5)
    samples = [samples_per_image(config, step, 10) for step in range(100)]
    assert samples[0] == config.loss.num_winners == 20
    assert samples[25] == int(20 * 20**0.5)  # half way in the growth
    assert (np.diff(samples) >= 0).all()
    assert set(samples[50:]) == {400}
    assert {samples_per_image(TrainConfig(epochs=30), step, 10) for step in range(300)} == {
        TrainConfig().loss.num_samples
    }


def test_arithmetic_is_chosen_by_hardware_and_network_unless_it_is_told(monkeypatch):
    cpu = torch.device("cpu")
    lite = PRESETS["efficientnet-lite0"]
    monkeypatch.setattr(torch.cuda, "is_bf16_supported", lambda **_: True)
    assert uses_bfloat16(lite, torch.device("cuda"))
    for capable in (False, True):
        told = {"amx_bf16": capable}
        monkeypatch.setattr(torch.cpu, "get_capabilities", lambda told=told: told, raising=False)
        assert uses_bfloat16(TrainConfig(), cpu) == capable
        assert not uses_bfloat16(lite, cpu)
        assert uses_bfloat16(replace(lite, precision="bfloat16"), cpu)
        assert not uses_bfloat16(TrainConfig(precision="float32"), cpu)


@pytest.mark.parametrize(
    ("kind", "change"),
    [
        (LossConfig, {"alpha": 0.0}),
        (LossConfig, {"lambda_rotation": float("nan")}),
        (LossConfig, {"num_samples": 0}),
        (AugmentConfig, {"brightness": -0.1}),
        (AugmentConfig, {"blur_probability": 1.5}),
        (Calibration, {"bandwidth_rotation_rad": 0.0}),
        (TrainConfig, {"bandwidth_translation_m": -1.0}),
        (TrainConfig, {"weight_decay": float("nan")}),
        (TrainConfig, {"initial_log_variance": 5.5}),
        (TrainConfig, {"epochs": 0}),
        (TrainConfig, {"batch_size": 1}),
    ],
)
def test_settings_out_of_range_are_refused(kind, change):
    ((name, value),) = change.items()
    with pytest.raises(VaporTrackError, match=rf"^{name} is {value}, expected between "):
        kind(**change)


GROWING = replace(PRESETS["demo"], epochs=10, small_images_first=0.8)


def test_images_grow_in_two_steps_to_those_of_the_network():
    sizes = [image_size(GROWING, epoch) for epoch in range(10)]
    assert sizes == [(64, 48)] * 4 + [(96, 72)] * 4 + [(160, 120)] * 2
    assert [first_epoch_of_size(GROWING, epoch) for epoch in range(10)] == [0] * 4 + [4] * 4 + [8] * 2
    assert {image_size(replace(GROWING, small_images_first=0.0), epoch) for epoch in range(10)} == {(160, 120)}
    assert [step_cost(GROWING, epoch) for epoch in (0, 4, 8)] == pytest.approx([0.328, 0.488, 1.0])


def test_no_image_is_smaller_than_a_network_can_see():
    small = replace(GROWING, network=replace(GROWING.network, image_width=60, image_height=40, shortest_edge=42))
    assert image_size(small, 0) == (48, 32)


@pytest.mark.usefixtures("unchecked")
def test_only_the_last_epochs_see_whole_images_and_are_evaluated(tmp_path, monkeypatch):
    seen = []

    def look(crops, *rest, original=batches.jitter_and_normalise):
        seen.append(tuple(crops.shape[1:3]))
        return original(crops, *rest)

    monkeypatch.setattr(batches, "jitter_and_normalise", look)
    network = replace(TINY.network, image_width=64, image_height=48, shortest_edge=48)
    config = replace(TINY, network=network, small_images_first=0.5, calibrate=False)
    result = train_on_most(make_frames(24), tmp_path / "m.safetensors", config)
    assert seen == [(32, 43)] * 4 + [(48, 64)] * 4  # two steps an epoch; two fifths would be less than 32
    assert [figures.epoch for figures in result.history] == [3, 4]
    assert result.best is not None
