import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import distributions

from filtering.se3 import Poses
from vapor.regressors.loss import pose_distance
from vapor.regressors.loss_config import LossConfig
from vapor.regressors.network_config import NetworkConfig
from vapor.regressors.scene_box import SceneBox
from vapor.regressors.variational import VariationalPoseRegressor, kl_divergence

BOX = SceneBox((-3.0, -3.0, -3.0), (3.0, 3.0, 3.0))
CONFIG = LossConfig(
    position_unit="metre", lambda_translation=5.0, lambda_rotation=2.0, alpha=0.2, beta=0.01, num_samples=25
)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=30)
def test_kl_divergence_is_that_of_torch_distributions(seed):
    mean, log_variance = torch.from_numpy(np.random.default_rng(seed).standard_normal((2, 4, 6)))
    normal = distributions.Normal(mean, torch.exp(0.5 * log_variance))
    expected = distributions.kl_divergence(normal, distributions.Normal(0.0, 1.0)).sum(-1)
    torch.testing.assert_close(kl_divergence(mean, log_variance), expected)


def test_pose_distance_is_the_weighted_sum_of_metres_and_chord():
    turned = torch.from_numpy(Poses.exp(np.array([0.0, 0.0, 0.0, 0.0, 0.0, np.pi])).rotation)
    distance = pose_distance(
        torch.tensor([3.0, 0.0, 4.0], dtype=torch.float64), turned, torch.zeros(3, dtype=torch.float64),
        torch.eye(3, dtype=torch.float64), CONFIG, BOX,
    )  # fmt: skip
    assert distance.item() == pytest.approx(5.0 * 5.0 + 2.0 * np.sqrt(8.0))


@pytest.mark.parametrize(("axis", "counts"), [(0, 1.0), (1, 2.0), (2, 10.0)])
def test_in_units_of_the_box_an_error_counts_as_much_more_as_its_edge_is_shorter_up_to_ten(axis, counts):
    box, config = SceneBox((0.0, 0.0, 1.0), (40.0, 20.0, 2.0)), LossConfig(lambda_translation=5.0, position_unit="box")
    wrong = torch.zeros(3)
    wrong[axis] = 0.1
    distance = pose_distance(wrong, torch.eye(3), torch.zeros(3), torch.eye(3), config, box)
    assert distance.item() == pytest.approx(5.0 * 0.1 * counts)


def test_a_perfect_prediction_has_a_finite_gradient():
    translation = torch.ones(3, requires_grad=True)
    rotation = torch.eye(3, requires_grad=True)
    pose_distance(translation, rotation, torch.ones(3), torch.eye(3), CONFIG, BOX).backward()
    assert translation.grad is not None
    assert rotation.grad is not None
    assert torch.isfinite(translation.grad).all()
    assert torch.isfinite(rotation.grad).all()


@pytest.mark.parametrize(
    ("alpha", "num_samples", "winners"), [(0.2, 1000, 200), (0.05, 1000, 50), (0.3, 10, 3), (0.29, 10, 2), (0.05, 4, 1)]
)
def test_winners_are_the_floor_of_alpha_m_and_at_least_one(alpha, num_samples, winners):
    assert LossConfig(alpha=alpha, num_samples=num_samples).num_winners == winners


def _batch():
    torch.manual_seed(0)
    config = NetworkConfig(image_width=32, image_height=32, shortest_edge=32, feature_dim=64, latent_dim=4)
    network = VariationalPoseRegressor(config, BOX).double().train()
    poses = Poses.exp(np.random.default_rng(0).standard_normal((6, 6)))
    truth = torch.from_numpy(poses.translation), torch.from_numpy(poses.rotation)
    return network, torch.randn(6, 3, 32, 32).double(), truth, torch.randn(6, 25, 4).double()


def _by_mapping_every_sample(network, images, truth, noise):
    mean, log_variance = network.encode(images)
    translation, rotation = network.decode(mean[:, None] + torch.exp(0.5 * log_variance)[:, None] * noise)
    metres = (translation - truth[0][:, None]).square().sum(-1).sqrt()
    chord = (rotation - truth[1][:, None]).square().sum((-2, -1)).sqrt()
    nearest = (5.0 * metres + 2.0 * chord).sort(dim=1).values[:, :5]
    kl = 0.5 * (mean**2 + log_variance.exp() - 1 - log_variance).sum(1)
    return 0.01 * kl.mean() + nearest.mean()


def test_mapping_only_the_winners_gives_the_loss_and_gradient_of_mapping_all():
    network, images, truth, noise = _batch()
    expected = _by_mapping_every_sample(network, images, truth, noise)
    expected.backward()
    gradients = {name: p.grad.clone() for name, p in network.named_parameters() if p.grad is not None}
    assert max(g.abs().max() for g in gradients.values()) > 1e-3
    network.zero_grad()
    loss = network.loss(images, *truth, noise, CONFIG)
    loss.backward()
    torch.testing.assert_close(loss, expected, rtol=1e-10, atol=0)
    for name, parameter in network.named_parameters():
        torch.testing.assert_close(parameter.grad, gradients[name], rtol=1e-7, atol=1e-10)
