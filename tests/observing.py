"""A model of random weights that observes."""

import numpy as np
import torch

from filtering.se3 import Poses
from vapor.checkpoints.calibration import Calibration
from vapor.checkpoints.checkpoint import Checkpoint
from vapor.observation import VaporObservationModel
from vapor.regressors.base import NetworkConfig, SceneBox, VariationalPoseRegressor

BOX = SceneBox((-1.0, 0.0, 2.0), (1.0, 10.0, 3.0))
CONFIG = NetworkConfig(image_width=32, image_height=32, shortest_edge=40, feature_dim=16, latent_dim=4)
IMAGE = np.random.default_rng(7).integers(0, 256, (60, 80, 3), dtype=np.uint8)


def make_checkpoint() -> Checkpoint:
    torch.manual_seed(0)
    poses = Poses.exp(np.random.default_rng(0).standard_normal((20, 6)))
    return Checkpoint(CONFIG, BOX, Calibration(), poses, VariationalPoseRegressor(CONFIG, BOX).state_dict())


MODEL = VaporObservationModel.from_checkpoint(make_checkpoint(), num_samples=50, device="cpu")


def observe(image, seed=0, model=MODEL):
    return model.observe(image, rng=np.random.default_rng(seed))
