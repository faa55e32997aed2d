import numpy as np
import torch

from filtering.se3 import Poses
from vapor.regressors.loss import LossConfig
from vapor.regressors.network_config import NetworkConfig
from vapor.regressors.retrieval import RetrievalRegressor
from vapor.regressors.scene_box import SceneBox

SIZE = {"image_width": 32, "image_height": 32, "shortest_edge": 36, "feature_dim": 64, "hidden_width": 32}


def test_features_far_beyond_those_of_the_training_give_gradients_that_are_numbers():
    torch.manual_seed(1)
    config = NetworkConfig("resnet18-quarter", head="retrieval", components=6, **SIZE)
    network = RetrievalRegressor(config, SceneBox((-2.0, -1.0, 0.0), (2.0, 3.0, 1.0)))
    poses = Poses.exp(np.random.default_rng(0).uniform(-1, 1, (20, 6)))
    truth = torch.from_numpy(poses.translation).float(), torch.from_numpy(poses.rotation).float()
    network.remember(torch.randn(20, len(network.centre)), *truth)
    far = 1e4 * torch.randn(4, len(network.centre))
    network.loss_of_features(far, truth[0][:4], truth[1][:4], None, LossConfig()).total.backward()
    gradients = [weight.grad for weight in network.parameters() if weight.grad is not None]
    assert gradients
    assert all(bool(torch.isfinite(gradient).all()) for gradient in gradients)
