"""The regressor that remembers its training images: what it recalls, what it must not, and what it learns of pairs."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from filtering.se3 import Poses
from sequences.frame import Frame
from tests.helpers.checks import no_checks
from tests.helpers.full import full
from tests.helpers.tiny_training import STILL, TINY, Interrupted, make_frames, pose
from vapor.checkpoints.file_format import load_checkpoint, save_checkpoint
from vapor.observation import VaporObservationModel
from vapor.regressors.network_config import NetworkConfig
from vapor.regressors.retrieval import RetrievalRegressor
from vapor.regressors.scene_box import SceneBox
from vapor.tensor_files import CheckpointError, read_safetensors, write_safetensors
from vapor.training import memory as training_memory
from vapor.training.augment_config import AugmentConfig
from vapor.training.holding_out import hold_out
from vapor.training.memory import VARIANTS, extract_training_features
from vapor.training.presets import METHODS
from vapor.training.state import start
from vapor.training.train import train_on
from vapor.training.trainer import plan
from vapor.training_data.load import load_training_set

BOX = SceneBox((-2.0, -1.0, 0.0), (2.0, 3.0, 1.0))
SMALL = NetworkConfig(
    "resnet18-quarter",
    head="retrieval",
    image_width=32,
    image_height=32,
    shortest_edge=36,
    feature_dim=64,
    hidden_width=32,
    components=6,
)
RETRIEVAL = replace(
    METHODS["retrieval"](TINY),
    network=SMALL,
    select_by="log_density",
    augment=STILL,
    epochs=10,
    finish=0.4,
    validation_fraction=0.2,
    learning_rate=3e-3,
    calibrate=False,
)


def made(count: int = 20) -> tuple[RetrievalRegressor, torch.Tensor, Poses]:
    """A network that remembers so many random features."""
    torch.manual_seed(1)
    network = RetrievalRegressor(SMALL, BOX).eval()
    features = torch.randn(count, len(network.centre))
    poses = Poses.exp(np.random.default_rng(0).uniform(-1, 1, (count, 6)))
    network.remember(features, torch.from_numpy(poses.translation).float(), torch.from_numpy(poses.rotation).float())
    return network, features, poses


def walk(count: int, *, begin: float, seed: int) -> list[Frame]:
    """Past a wall of noise, seen through a window that moves along with the camera; each walk a little aside."""
    wall = np.random.default_rng(0).integers(0, 256, (36, 400, 3), dtype=np.uint8)
    rng = np.random.default_rng(seed)
    frames = []
    for i in range(count):
        x = begin + 5.0 + 2.0 * i + rng.uniform(-0.5, 0.5)
        column = round(x)
        at = Poses(np.eye(3), np.array([column / 100, 0.002 * seed, 0.0]))
        noisy = np.clip(wall[:, column : column + 48] + rng.normal(0, 5, (36, 48, 3)), 0, 255).astype(np.uint8)
        frames.append(Frame(i * 10**8, noisy, None, at))
    return frames


# --- what is recalled ------------------------------------------------------------------------------


@torch.no_grad()
def test_an_image_that_is_remembered_is_recalled_first_and_with_its_pose():
    network, features, poses = made()
    network.relative[-1].weight.zero_()  # nothing learned of pairs: poses as they are remembered
    mixture = network.components(features[:5])
    heaviest = mixture.log_weights.argmax(dim=1)
    at = mixture.translation[torch.arange(5), heaviest]
    np.testing.assert_allclose(at.numpy(), poses.translation[:5], atol=1e-5)
    turned = mixture.rotation[torch.arange(5), heaviest]
    np.testing.assert_allclose(turned.numpy(), poses.rotation[:5], atol=1e-5)
    torch.testing.assert_close(mixture.log_weights.exp().sum(dim=1), torch.ones(5))
    assert mixture.widths[..., 0].unique().item() == pytest.approx(0.02 * (4.0 * 4.0 * 1.0) ** (1 / 3))


@torch.no_grad()
def test_what_is_hidden_has_no_weight():
    network, features, poses = made()
    network.relative[-1].weight.zero_()
    hidden = torch.zeros(5, 20, dtype=torch.bool)
    hidden[torch.arange(5), torch.arange(5)] = True
    mixture = network.components(features[:5], hidden)
    apart = (mixture.translation - torch.from_numpy(poses.translation[:5]).float()[:, None]).norm(dim=-1)
    assert mixture.log_weights[apart < 1e-4].exp().sum() < 1e-6
    torch.testing.assert_close(mixture.log_weights.exp().sum(dim=1), torch.ones(5))


def test_the_backbone_never_changes():
    network, _, poses = made()
    before = {name: value.clone() for name, value in network.backbone.state_dict().items()}
    network.train()
    optimizer = torch.optim.AdamW(network.parameters(), lr=0.1)
    truth = torch.from_numpy(poses.translation[:4]).float(), torch.from_numpy(poses.rotation[:4]).float()
    feature = network.extract_features(torch.randn(4, 3, 32, 32))
    network.loss_of_features(feature, *truth, None).backward()
    weight = network.key.weight.detach().clone()
    optimizer.step()
    assert not torch.equal(network.key.weight, weight)
    assert all(torch.equal(before[name], value) for name, value in network.backbone.state_dict().items())


def test_features_far_beyond_those_of_the_training_give_gradients_that_are_numbers():
    network, features, poses = made()
    truth = torch.from_numpy(poses.translation[:4]).float(), torch.from_numpy(poses.rotation[:4]).float()
    network.loss_of_features(1e4 * features[:4], *truth, None).backward()
    gradients = [weight.grad for weight in network.parameters() if weight.grad is not None]
    assert gradients
    assert all(bool(torch.isfinite(gradient).all()) for gradient in gradients)


# --- what must not be recalled while it learns -----------------------------------------------------


def test_an_image_is_hidden_from_its_own_pass_and_shown_to_others():
    images = load_training_set(
        {"a": walk(100, begin=0, seed=1), "b": walk(100, begin=0, seed=2), "c": walk(30, begin=250, seed=3)}, (36, 36)
    )
    network = RetrievalRegressor(SMALL, BOX)
    seen = extract_training_features(network, images)
    hidden = seen.hidden(np.arange(len(images))).numpy()
    sequence, way = images.sequence, seen.way.numpy()
    same = sequence[:, None] == sequence
    assert not hidden[~same].any()
    assert np.diag(hidden).all()
    shared = sequence < 2
    ahead = np.abs(way[:, None] - way)
    assert (hidden == (ahead < 1.0))[same & shared[:, None]].all()  # another walk shows these
    assert (hidden == (ahead < 0.2))[same & ~shared[:, None]].all()  # and nothing else these: they learn of their own
    assert hidden[50].sum() > hidden[215].sum() >= 1


def test_images_are_varied_in_a_few_ways_each_found_once(monkeypatch):
    images = load_training_set({"a": walk(30, begin=0, seed=1)}, (36, 36))
    network = RetrievalRegressor(SMALL, BOX)
    config = replace(RETRIEVAL, augment=AugmentConfig())
    seen = extract_training_features(network, images)
    assert seen.num_variants == VARIANTS
    looked, extract = [], network.extract_features
    monkeypatch.setattr(network, "extract_features", lambda x: (looked.append(len(x)), extract(x))[1])
    first, second = (seen.varied(network, number, config, bfloat16=False) for number in (0, 1))
    assert (first - second).abs().max() > 0.1
    assert seen.varied(network, VARIANTS, config, bfloat16=False) is first
    assert sum(looked) == 2 * 30
    again = extract_training_features(network, images).varied(
        network, 1, config, bfloat16=False
    )  # as after an interruption
    assert torch.equal(again, second)
    monkeypatch.setattr(training_memory, "_VARIANTS_BYTES", 2 * seen.features.nbytes + 10)
    assert seen.num_variants == 2


# --- training --------------------------------------------------------------------------------------


def trained(output: Path, **more):
    walks = {name: walk(40, begin=0, seed=seed) for seed, name in enumerate("abcde")}
    return train_on(walks, output, replace(RETRIEVAL, **more.pop("changes", {})), **more)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A finished training, and its file."""
    output = tmp_path_factory.mktemp("retrieval") / "m.safetensors"
    with no_checks():
        result = trained(output)
    save_checkpoint(output, result.checkpoint)  # not rounded
    return result, output


def test_it_learns_where_a_view_is_from_walks_that_it_does_not_remember(whole):
    result = whole[0]
    first, last = result.history[0], result.best
    assert last is not None
    assert last.train_loss < first.train_loss - 1.0  # nats, its own pass being hidden from each image
    model = VaporObservationModel.from_checkpoint(result.checkpoint, num_samples=300, device="cpu")
    apart = []
    for frame in walk(40, begin=0, seed=9)[::4]:
        samples = model.observe(frame.image, rng=np.random.default_rng(0)).samples
        apart.append(np.median(samples.distance(pose(frame))[0]))
    assert np.median(apart) < 0.1  # by chance 0.27 m, on this walk of 0.8 m


def test_in_the_end_everything_is_remembered(whole, tmp_path):
    memory = whole[0].checkpoint.memory
    assert memory is not None
    assert len(memory.keys) == 5 * 40
    without = trained(tmp_path / "m.safetensors", changes={"finish": 0.0, "epochs": 1}).checkpoint.memory
    assert without is not None
    assert len(without.keys) < 5 * 40


@pytest.mark.parametrize(("hours", "epochs"), [(1e-9, 4), (100.0, 6)])
def test_epochs_are_as_many_as_fit_but_no_more_than_help(hours, epochs):
    images = load_training_set({"a": walk(40, begin=0, seed=1), "b": walk(40, begin=0, seed=2)}, (36, 36))
    split = hold_out(images, 0.0)
    config = replace(RETRIEVAL, epochs=None, hours=hours, most_epochs=6)
    state = start(config, SceneBox.around(images.poses), images.poses, None)
    assert plan(state, split, 0, config).epochs == epochs
    assert state.features is None


@full
@pytest.mark.usefixtures("unchecked")
def test_a_training_that_is_interrupted_twice_ends_with_the_same_weights_and_memory(whole, tmp_path):
    output = tmp_path / "m.safetensors"
    for stage in ("training", "training on everything"):
        steps = []

        def progress(p, stage=stage, steps=steps):
            steps.append(p.stage == stage)
            if sum(steps) == 35:  # in the middle of an epoch
                raise Interrupted

        with pytest.raises(Interrupted):
            trained(output, progress=progress)
    resumed, uninterrupted = trained(output).checkpoint, whole[0].checkpoint
    assert all(torch.equal(resumed.state_dict[name], value) for name, value in uninterrupted.state_dict.items())
    assert resumed.memory is not None
    assert all(torch.equal(resumed.memory.tensors()[k], value) for k, value in uninterrupted.memory.tensors().items())


# --- the file --------------------------------------------------------------------------------------


def test_a_model_remembers_after_it_was_written_and_read(whole):
    result, file = whole
    loaded = load_checkpoint(file)
    assert loaded.network_sha256() == result.checkpoint.network_sha256()
    image = make_frames(1)[0].image
    first, second = (
        VaporObservationModel.from_checkpoint(c, num_samples=20, device="cpu").observe(
            image, rng=np.random.default_rng(0)
        )
        for c in (result.checkpoint, loaded)
    )
    np.testing.assert_array_equal(first.samples.as_matrix(), second.samples.as_matrix())
    network = loaded.build_network()
    memory = network.memory
    assert memory is not None
    assert memory.translation.dtype == torch.float32
    assert (network.double().memory.keys.dtype) == torch.float64  # it goes where the network goes


@pytest.mark.parametrize(
    ("name", "change", "said"),
    [
        ("memory.views", None, "lacks tensor memory.views"),
        ("memory.keys", lambda t: t[:, :3], "memory.keys has shape"),
        ("memory.translation", lambda t: t[:-1], r"memory.translation have shapes \(200, 3, 3\) and \(199, 3\)"),
        ("memory.translation", lambda t: t * float("nan"), "memory.translation has values that are not finite"),
        ("memory.rotation", lambda t: 2 * t, "memory.rotation has .* not rotations"),
    ],
)
def test_a_damaged_memory_is_refused(whole, tmp_path, name, change, said):
    (metadata, tensors), file = read_safetensors(whole[1]), tmp_path / "m.safetensors"
    tensors = {k: v for k, v in tensors.items() if change or k != name}
    if change:
        tensors[name] = change(tensors[name])
    write_safetensors(file, tensors, metadata)
    with pytest.raises(CheckpointError, match=said):
        load_checkpoint(file)
