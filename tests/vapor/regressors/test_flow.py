"""Densities that networks give themselves: exact, drawn from as they are evaluated, learned, kept and used."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from filtering.se3 import Poses
from tests.helpers.full import full
from tests.helpers.tiny_training import STILL, TINY, make_frames
from vapor.checkpoints.calibration import Calibration
from vapor.checkpoints.checkpoint import Checkpoint
from vapor.checkpoints.file_format import load_checkpoint, save_checkpoint
from vapor.evaluation.posterior import posterior_metrics
from vapor.evaluation.validation import LOG_FLOOR, exact_log_density
from vapor.regressors.base import DensityRegressor
from vapor.regressors.flow import FlowRegressor, Spline
from vapor.regressors.loss_config import LossConfig
from vapor.regressors.network_config import NetworkConfig, make_regressor
from vapor.regressors.scene_box import SceneBox
from vapor.training.presets import METHODS
from vapor.training.train import train_on
from vapor.training_data.load import load_training_set

pytestmark = pytest.mark.usefixtures("unchecked")

BOX = SceneBox((-1.0, -1.0, 0.0), (1.0, 2.0, 2.0))
AROUND = {"flow": BOX, "mixture": SceneBox((-3.0, -3.0, -2.0), (3.0, 4.0, 4.0))}  # all that a density reaches
CONFIG = NetworkConfig(
    image_width=32, image_height=32, shortest_edge=32, feature_dim=32, hidden_width=32, hidden_layers=1, components=6
)
FEATURE = torch.relu(torch.randn(1, 32, generator=torch.Generator().manual_seed(3)))
IMAGE = np.random.default_rng(7).integers(0, 256, (40, 40, 3), dtype=np.uint8)


def network_with(head) -> DensityRegressor:
    torch.manual_seed(1)
    network = make_regressor(replace(CONFIG, head=head), BOX).eval()
    assert isinstance(network, DensityRegressor)
    with torch.no_grad():  # random weights alone make densities that are nearly flat
        if isinstance(network, FlowRegressor):
            for conditional in network.conditionals:
                conditional.last.weight.mul_(6.0)
        else:
            network.log_widths.bias.copy_(torch.tensor([0.6, 0.9] * 6))  # half a metre and half a radian
    return network


def uniform(count: int, box: SceneBox, seed: int = 0):
    """Translations, rotations, and the volume that they fill."""
    rng = np.random.default_rng(seed)
    translation = rng.uniform(box.lower, box.upper, (count, 3))
    rotation = Rotation.random(count, random_state=rng).as_matrix()
    volume = np.prod(np.subtract(box.upper, box.lower)) * 8 * np.pi**2
    return torch.from_numpy(translation).float()[None], torch.from_numpy(rotation).float()[None], volume


def draw(network: DensityRegressor, count: int, seed: int = 0):
    noise = torch.randn(1, count, network.noise_dim, generator=torch.Generator().manual_seed(seed))
    with torch.inference_mode():
        return network.sample(FEATURE, noise)


def density(network: DensityRegressor, translation, rotation) -> np.ndarray:
    with torch.inference_mode():
        parts = [
            network.log_density(FEATURE, t, r)[0]
            for t, r in zip(translation.split(20_000, 1), rotation.split(20_000, 1), strict=True)
        ]
    return torch.cat(parts).double().exp().numpy()


def checkpoint_of(network: FlowRegressor) -> Checkpoint:
    translation, rotation = draw(network, 30)
    poses = Poses(rotation[0].double().numpy(), translation[0].double().numpy())
    return Checkpoint(network.config, BOX, Calibration(), poses, network.state_dict())


# --- the density -----------------------------------------------------------------------------------


@pytest.fixture(scope="module", params=["flow", "mixture"])
def evaluated(request):
    """A network, poses all over what its density reaches, their volume, and the density at each."""
    network = network_with(request.param)
    translation, rotation, volume = uniform(100_000, AROUND[request.param])
    return network, translation, rotation, volume, density(network, translation, rotation)


def test_the_density_integrates_to_one_over_positions_and_rotations(evaluated):
    _, _, _, volume, found = evaluated
    share = volume * found
    error = share.std() / np.sqrt(len(share))
    assert error < 0.05
    assert share.mean() == pytest.approx(1.0, abs=4 * error)


def test_draws_follow_the_density(evaluated):
    network, translation, rotation, _, weights = evaluated
    drawn = draw(network, 40_000)
    effective = weights.sum() ** 2 / (weights**2).sum()
    for ours, theirs in zip(
        torch.cat([drawn[0], drawn[1].flatten(2)], -1)[0].T.numpy(),
        torch.cat([translation, rotation.flatten(2)], -1)[0].T.numpy(),
        strict=True,
    ):
        order = np.argsort(theirs)
        below = np.searchsorted(np.sort(ours), theirs[order]) / len(ours)
        cumulative = weights[order].cumsum() / weights.sum()
        # Passed by chance in one of 10⁴ comparisons (Kolmogorov), for so many draws and as many weighted poses.
        assert np.abs(below - cumulative).max() < 2.2 * np.sqrt(1 / len(ours) + 1 / effective)


def test_inverse_splines_undo_their_slopes():
    raw = 2.0 * torch.randn(1, 1, 24, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    for circular in (False, True):
        spline = Spline.of(raw.expand(1, 4001, -1), circular=circular)
        y = torch.linspace(0.0, 1.0, 4001, dtype=torch.float64)[None]
        x = spline.inverse(y)
        assert (x[0, 0], x[0, -1]) == pytest.approx((0.0, 1.0), abs=1e-6)
        assert (x.diff() > 0).all()
        slope = (y[0, 2:] - y[0, :-2]) / (x[0, 2:] - x[0, :-2])
        difference = (slope.log() - spline.log_slope(x)[0, 1:-1]).abs()
        assert difference.quantile(0.95) < 0.01  # the rest is where bins meet
        ends = spline.log_slope(x)[0, [0, -1]]
        assert not circular or ends[0] == pytest.approx(float(ends[1]), abs=1e-4)


@pytest.mark.parametrize("circular", [False, True])
def test_splines_of_any_numbers_stay_finite_in_single_precision(circular):
    raw = (30.0 * torch.randn(1, 4000, 96, generator=torch.Generator().manual_seed(1))).requires_grad_()
    at = torch.rand(1, 4000, generator=torch.Generator().manual_seed(2))
    at[0, :2] = torch.tensor([0.0, 1.0])
    spline = Spline.of(raw, circular=circular)
    slope = spline.log_slope(at)
    slope.sum().backward()
    x = spline.inverse(at).detach()
    assert torch.isfinite(slope).all()
    assert torch.isfinite(raw.grad).all()
    assert ((x >= 0.0) & (x <= 1.0)).all()


def test_the_most_noise_on_targets_leaves_a_camera_in_its_box():
    # All cameras at one height: the box has its least margin there, 0.3 m.
    flat = Poses.exp(np.zeros((200, 6)))
    network = make_regressor(replace(CONFIG, head="flow"), SceneBox.around(flat)).train()
    truth = torch.zeros(200, 3), torch.eye(3).expand(200, 3, 3)
    noise = torch.randn(200, 1, 6, generator=torch.Generator().manual_seed(0)).clamp(-5.9, 5.9)
    noise[0, 0, :3] = 5.9
    images = torch.zeros(200, 3, 32, 32)
    assert torch.isfinite(network.loss(images, *truth, noise, LossConfig()))


def test_the_density_is_nothing_outside_the_box():
    network = network_with("flow")
    translation = torch.tensor([[[0.0, 0.0, 1.0], [1.01, 0.0, 1.0], [0.0, 0.0, -50.0]]])
    found = network.log_density(FEATURE, translation, torch.eye(3).expand(1, 3, 3, 3))[0]
    assert torch.isfinite(found).tolist() == [True, False, False]
    assert (found[1:] == -torch.inf).all()


def test_axes_are_taken_that_no_camera_of_the_training_brings_together():
    rng = np.random.default_rng(0)
    turn = Rotation.from_euler("z", rng.uniform(-np.pi, np.pi, (200, 1))).as_matrix()
    tilt = Rotation.from_rotvec(rng.normal(0.0, 0.1, (200, 3))).as_matrix()
    level = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # looks along x, its y down
    for rotation in (turn @ tilt, turn @ level @ tilt):  # looks up at a ceiling; looks around
        network = network_with("flow")
        network.choose_axes(Poses(rotation, np.zeros((200, 3))))
        cosine = (network.world_axes.mT.double() @ torch.from_numpy(rotation) @ network.camera_axes.mT.double())[
            :, 2, 2
        ]
        assert cosine.abs().max() < 0.5
        assert torch.linalg.det(network.world_axes) == torch.linalg.det(network.camera_axes) == 1.0


# --- learning --------------------------------------------------------------------------------------


@full
def test_a_posterior_of_two_places_is_learned_with_both_and_as_sharp_as_it_is():
    network = network_with("flow")
    network.extract_features = lambda images: FEATURE.expand(len(images), -1)
    places = Poses.exp(np.array([[-0.4, 0.3, 1.0, 0.0, 0.0, 0.5], [0.5, 1.2, 0.6, 1.0, 0.0, -0.8]]))
    network.choose_axes(places)
    truth = (
        torch.from_numpy(places.translation).float().repeat(32, 1),
        torch.from_numpy(places.rotation).float().repeat(32, 1, 1),
    )
    config = LossConfig()
    optimizer = torch.optim.Adam(network.parameters(), lr=5e-3)
    generator = torch.Generator().manual_seed(0)
    losses = []
    for step in range(300):
        optimizer.param_groups[0]["lr"] = 5e-3 * (1 - step / 300)
        noise = torch.randn(64, 1, 6, generator=generator)
        loss = network.loss(torch.zeros(64, 3, 1, 1), *truth, noise, config)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    entropy = np.log(2) + 6 * (np.log(0.05) + 0.5 * np.log(2 * np.pi * np.e))
    assert entropy - 0.3 < np.mean(losses[-50:]) < entropy + 1.0
    translation, rotation = (part[0].double().numpy() for part in draw(network, 2000))
    apart = [Poses(rotation, translation).distance(places[[k]]) for k in range(2)]
    first, second = (((metres < 0.2) & (radians < 0.2)).mean() for metres, radians in apart)
    assert first + second > 0.85
    assert abs(first - second) < 0.2


# --- use -------------------------------------------------------------------------------------------


def test_a_model_file_keeps_samples_densities_and_axes(tmp_path):
    network = network_with("flow")
    up = Rotation.from_euler("z", np.linspace(0, 3, 9)[:, None]).as_matrix()
    network.choose_axes(Poses(up, np.zeros((9, 3))))
    assert not torch.equal(network.world_axes, torch.eye(3)) or not torch.equal(network.camera_axes, torch.eye(3))
    save_checkpoint(tmp_path / "m.safetensors", checkpoint_of(network))
    restored = load_checkpoint(tmp_path / "m.safetensors").build_network()
    for ours, theirs in zip(draw(network, 20), draw(restored, 20), strict=True):
        assert torch.equal(ours, theirs)
    np.testing.assert_array_equal(density(network, *draw(network, 20)), density(restored, *draw(network, 20)))


def test_training_takes_the_axes_of_its_poses_and_is_judged_by_its_own_density(tmp_path):
    frames = make_frames(8, seed=3)
    config = replace(METHODS["flow"](TINY), augment=STILL, epochs=1, resume=False, validation_fraction=0.0)
    trained = train_on({"a": frames * 4}, tmp_path / "m.safetensors", config).checkpoint
    network, images = trained.build_network(), load_training_set({"a": frames}, config.network.frame_size)
    rotation = network.state_dict()["world_axes"].double().numpy().T @ images.poses.rotation
    cosine = (rotation @ network.state_dict()["camera_axes"].double().numpy().T)[:, 2, 2]
    assert np.abs(cosine).max() == pytest.approx(np.abs(images.poses.rotation).max(axis=0).min())
    exact = exact_log_density(network, images)
    assert exact is not None
    assert np.isfinite(exact).all()
    figures = posterior_metrics([images.poses] * 8, images.poses, trained.calibration, exact_log_density=exact)
    assert figures["exact_negative_log_density"] == pytest.approx(-np.logaddexp(exact, LOG_FLOOR).mean())
    assert exact_log_density(make_regressor(TINY.network, BOX), images) is None
