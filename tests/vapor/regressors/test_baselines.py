"""The regressors beside the variational one: what they predict, what they are trained with, and that they learn."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from filtering.density import KernelDensity
from filtering.errors import VaporTrackError
from filtering.se3 import Poses
from tests.helpers.full import some
from tests.helpers.tiny_training import STILL, TINY, make_frames, pose
from vapor.checkpoints.file_format import load_checkpoint
from vapor.observation import VaporObservationModel
from vapor.regressors.loss_config import LossConfig
from vapor.regressors.mixture import log_rotation_normaliser
from vapor.regressors.network_config import NetworkConfig, make_regressor
from vapor.regressors.scene_box import SceneBox
from vapor.training.epoch import paired
from vapor.training.presets import METHODS
from vapor.training.train import train_on

BOX = SceneBox((-2.0, -1.0, 0.0), (2.0, 3.0, 1.0))
SMALL = NetworkConfig(image_width=32, image_height=32, shortest_edge=32, feature_dim=32, latent_dim=4, components=5)
HEADS = ("variational", "deterministic", "point", "dropout", "mixture", "flow")
IMAGES = torch.randn(3, 3, 32, 32, generator=torch.Generator().manual_seed(0))


def network_with(head, **changes):
    torch.manual_seed(1)
    return make_regressor(replace(SMALL, head=head, **changes), BOX).eval()


def draw(network, count: int, seed: int = 0):
    noise = torch.randn(3, count, network.noise_dim, generator=torch.Generator().manual_seed(seed))
    with torch.no_grad():
        return network(IMAGES, noise)


def truth_of(count: int):
    poses = Poses.exp(np.random.default_rng(0).uniform(-1, 1, (count, 6)))
    return torch.from_numpy(poses.translation).float(), torch.from_numpy(poses.rotation).float()


# --- predictions -----------------------------------------------------------------------------------


@pytest.mark.parametrize("head", HEADS)
def test_every_head_gives_rigid_poses_that_follow_from_the_noise(head):
    network = network_with(head)
    translation, rotation = draw(network, 50)
    assert translation.shape == (3, 50, 3)
    assert rotation.shape == (3, 50, 3, 3)
    torch.testing.assert_close(rotation @ rotation.mT, torch.eye(3).expand(3, 50, 3, 3), atol=1e-5, rtol=0)
    again = draw(network, 50)
    assert torch.equal(translation, again[0])
    assert (translation[0] - translation[1]).abs().max() > 1e-4  # the image matters
    spread = translation.std(dim=1).max()
    assert spread > 1e-3 if head in ("variational", "dropout", "mixture", "flow") else spread < 1e-6


def test_dropout_leaves_out_its_share_of_the_units():
    network = network_with("dropout", dropout=0.9, feature_dim=512)
    kept = []
    network.pose_map.hidden.register_forward_hook(lambda _, inputs, __: kept.append(inputs[0]))
    draw(network, 200)
    alive = kept[0][:, :, kept[0].abs().amax(dim=(0, 1)) > 0]  # units that the ReLU lets through for some image
    feature = network.extract_features(IMAGES)[:, kept[0].abs().amax(dim=(0, 1)) > 0]
    share = ((alive > 0) | (feature[:, None] == 0)).float().mean() - (feature == 0).float().mean()
    assert share / (feature > 0).float().mean() == pytest.approx(0.1, abs=0.01)
    torch.testing.assert_close(alive.mean(dim=1).mean(), feature.mean(), rtol=0.1, atol=0)  # and the mean stays


@pytest.mark.parametrize("width", [0.02, 0.3, 1.5])
def test_the_rotation_normaliser_is_that_of_the_kernel_density(width):
    density = KernelDensity(Poses.identity(1), 1.0, width)
    log_position = 1.5 * np.log(2 * np.pi)
    ours = float(log_rotation_normaliser(torch.tensor(width)))
    assert ours == pytest.approx(density.log_normaliser[0] - log_position, abs=1e-3)


# --- losses ----------------------------------------------------------------------------------------


def test_the_likelihood_of_a_single_component_is_its_kernel_density():
    network = network_with("mixture", components=1)
    truth = truth_of(3)
    loss = network.loss(IMAGES, *truth, torch.zeros(3, 1, 8), LossConfig())
    components = network.components(network.extract_features(IMAGES))
    _, translation, rotation, widths = (part.detach().double().numpy() for part in components)
    for_each = [
        KernelDensity(Poses(rotation[i], translation[i]), *widths[i, 0]).log_density(
            Poses(truth[1].double().numpy()[[i]], truth[0].double().numpy()[[i]])
        )[0]
        for i in range(3)
    ]
    assert float(loss.detach()) == pytest.approx(-np.mean(for_each), rel=1e-3)


def test_only_the_best_component_learns_but_for_the_relaxation(monkeypatch):
    monkeypatch.setattr("vapor.regressors.mixture._RELAXATION", 0.0)
    network = network_with("mixture")
    truth = truth_of(3)
    best = network.loss(IMAGES, *truth, torch.zeros(3, 1, 8), LossConfig())
    best.backward()
    moved = (network.translation.weight.grad.unflatten(0, (5, 3)).abs().amax(dim=(1, 2)) > 0).sum()
    assert 1 <= moved <= 3  # of five components, at most one an image
    network.zero_grad()
    monkeypatch.setattr("vapor.regressors.mixture._RELAXATION", 0.2)
    network.loss(IMAGES, *truth, torch.zeros(3, 1, 8), LossConfig()).backward()
    assert (network.translation.weight.grad.unflatten(0, (5, 3)).abs().amax(dim=(1, 2)) > 0).all()


def test_errors_of_position_and_rotation_are_weighted_by_scales_that_learn():
    network = network_with("point")
    truth = truth_of(3)
    loss = network.loss(IMAGES, *truth, torch.zeros(3, 1, 0), LossConfig(position_unit="metre"))
    translation, rotation = (part[:, 0] for part in draw(network, 1))
    metres = (translation - truth[0]).norm(dim=-1).mean()
    chord = (rotation - truth[1]).flatten(1).norm(dim=-1).mean()
    torch.testing.assert_close(loss.detach(), metres + 0.0 + chord * np.exp(3.0) - 3.0, rtol=1e-4, atol=0)
    loss.backward()
    assert (network.log_scale.grad != 0).all()


def test_relative_poses_of_a_pair_do_not_depend_on_the_frame_of_the_map():
    network = network_with("point")
    images = torch.cat([IMAGES, IMAGES.flip(0)])
    truth = truth_of(6)
    noise = torch.zeros(6, 1, 0)
    plain, paired = (
        network.loss(images, *truth, noise, LossConfig(position_unit="metre", relative=relative))
        for relative in (0.0, 2.0)
    )
    with torch.no_grad():
        poses = network(images, noise)
    here, there = (
        [Poses(r.double().numpy(), t.double().numpy()) for t, r in zip(*pair, strict=True)]
        for pair in ((poses[0][:, 0], poses[1][:, 0]), truth)
    )
    errors = []
    for i in range(3):
        mine, its = here[i].inverse() @ here[i + 3], there[i].inverse() @ there[i + 3]
        errors.append(
            [np.linalg.norm(mine.translation - its.translation), np.linalg.norm(mine.rotation - its.rotation)]
        )
    metres, chord = np.mean(errors, axis=0)
    expected = 2.0 * (metres + chord * np.exp(3.0) - 3.0)
    assert float((paired - plain).detach()) == pytest.approx(expected, rel=1e-4)


def test_pairs_are_of_one_sequence_and_near_each_other():
    sequence = np.repeat([0, 1, 2], [30, 30, 1])
    rng = np.random.default_rng(0)
    gaps = []
    for _ in range(200):
        batch = paired(rng.permutation(61)[:20], sequence, 4, rng=rng)
        first, second = batch[:10], batch[10:]
        np.testing.assert_array_equal(sequence[first], sequence[second])
        gaps += [abs(a - b) for a, b in zip(first, second, strict=True) if a != 60]
    assert set(gaps) == {1, 2, 3, 4}  # never with itself, but for the image that is alone


# --- training and use ------------------------------------------------------------------------------


LEARNED = (
    ("variational", 2, 8, 6, 24, 6e-3),
    ("no-sampling", 2, 8, 9, 24, 6e-3),  # with 6 epochs one seed in ten learns nothing
    ("bayesian-posenet", 2, 8, 10, 30, 6e-3),
    ("mapnet", 3, 12, 6, 45, 6e-3),  # from pairs it learns more slowly
    ("mixture-10", 3, 12, 12, 80, 2e-3),  # which image it is makes little of a density's loss, and is learned last
    ("flow", 3, 12, 12, 80, 2e-3),
)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(("method", "images", "batch", "epochs", "repeats", "rate"), some(3, [*LEARNED]))
def test_methods_of_every_kind_learn_where_images_are_and_drive_a_posterior(
    method, images, batch, epochs, repeats, rate, tmp_path
):
    frames = make_frames(images, seed=3)
    config = replace(TINY, augment=STILL, epochs=epochs, batch_size=batch, learning_rate=rate, ema_decay=0.9)
    config = METHODS[method](config)
    config = replace(config, validation_fraction=0.0, resume=False, loss=replace(config.loss, pair_gap=2))
    network = replace(config.network, dropout=0.1, components=min(config.network.components, 4))
    path = tmp_path / "m.safetensors"
    result = train_on({"a": frames * repeats}, path, replace(config, network=network))
    model = VaporObservationModel.from_checkpoint(load_checkpoint(path), num_samples=200, device="cpu", engine="torch")
    errors = []
    for i, frame in enumerate(frames):
        samples = model.observe(frame.image, rng=np.random.default_rng(i)).samples
        errors.append(np.median(samples.distance(pose(frame))[0]))
    spread = np.std([pose(frame).translation for frame in frames], axis=0)
    assert np.mean(errors) < 0.5 * np.linalg.norm(spread)
    assert result.checkpoint.network.head == config.network.head


def test_relative_poses_are_asked_of_point_regressors_only():
    mapnet = METHODS["mapnet"](TINY)
    with pytest.raises(VaporTrackError, match="expected head point or dropout"):
        replace(mapnet, network=replace(TINY.network, head="variational"))


@pytest.mark.parametrize("head", HEADS)
def test_losses_are_the_same_under_eight_bit_autocast_but_for_the_encoder(head):
    network = network_with(head)
    images, truth = torch.cat([IMAGES, IMAGES.flip(0)]), truth_of(6)
    count = 8 if head == "variational" else 1
    noise = torch.randn(6, count, network.noise_dim, generator=torch.Generator().manual_seed(0))
    features = network.extract_features(images).detach()
    network.extract_features = lambda _: features
    config = LossConfig(num_samples=8, relative=1.0 if head in ("point", "dropout") else 0.0)
    exact = network.loss(images, *truth, noise, config)
    with torch.autocast("cpu", torch.bfloat16):
        under = network.loss(images, *truth, noise, config)
    torch.testing.assert_close(under, exact, rtol=1e-5, atol=1e-5)
