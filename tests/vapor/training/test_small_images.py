"""Trainings whose first images are small."""

from dataclasses import replace

import pytest

from tests.helpers.tiny_training import TINY, make_frames, train_on_most
from vapor.training import batches
from vapor.training.presets import PRESETS
from vapor.training.schedule import first_epoch_of_size, image_size, step_cost

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
