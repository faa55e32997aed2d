"""The table of regressors: each name makes one that samples poses and learns, by the interface that all have."""

import numpy as np
import pytest
import torch

from filtering.se3 import Poses
from vapor.regressors.base import DensityRegressor, PoseRegressor
from vapor.regressors.loss_config import LossConfig
from vapor.regressors.network_config import REGRESSORS, NetworkConfig, make_regressor, regressor_class
from vapor.regressors.scene_box import SceneBox

BOX = SceneBox((-2.0, -2.0, -2.0), (2.0, 2.0, 2.0))
POSES = Poses.exp(np.random.default_rng(0).uniform(-1, 1, (4, 6)))
TRUTH = torch.from_numpy(POSES.translation).float(), torch.from_numpy(POSES.rotation).float()
IMAGES = torch.randn(4, 3, 32, 32, generator=torch.Generator().manual_seed(0))


def made(head: str) -> PoseRegressor:
    """A small regressor as it is before its first step, with something to recall where it recalls images."""
    torch.manual_seed(0)
    config = NetworkConfig("resnet18-quarter", head, 32, 32, 32, feature_dim=16, latent_dim=4, hidden_width=16)
    network = make_regressor(config, BOX)
    network.initialise(POSES, log_variance=-4.0)
    if network.recalling is not None:
        network.recalling.remember(network.extract_features(IMAGES), *TRUTH)
    return network.train()


@pytest.mark.parametrize("head", REGRESSORS)
def test_every_regressor_has_a_loss_that_reaches_its_weights_and_samples_poses(head):
    network = made(head)
    assert type(network) is regressor_class(head)
    noise = torch.randn(4, network.samples_in_training(8), network.noise_dim)
    loss = network.loss(IMAGES, *TRUTH, noise, LossConfig(num_samples=8))
    loss.backward()
    reached = [p for p in network.parameters() if p.grad is not None and p.grad.abs().max() > 0]
    assert len(reached) > 3
    learned = {id(p) for p in reached}
    assert any(id(p) in learned for p in network.backbone.parameters()) != network.frozen_backbone
    translation, _ = network.eval()(IMAGES, torch.randn(4, 5, network.noise_dim))
    assert translation.shape == (4, 5, 3)


@pytest.mark.parametrize("head", REGRESSORS)
def test_what_is_a_density_or_recalls_images_says_so_itself(head):
    network = made(head)
    assert isinstance(network, DensityRegressor) == (head in ("mixture", "flow", "retrieval"))
    assert network.recalling is (network if head == "retrieval" else None)
    assert (network.memory is not None) == (head == "retrieval")
