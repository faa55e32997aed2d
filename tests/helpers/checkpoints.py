"""A model of random weights, as it is stored."""

from dataclasses import replace

import numpy as np
import torch

from filtering.error_model import ErrorModel
from filtering.se3 import Poses
from vapor.checkpoints.calibration import Calibration
from vapor.checkpoints.checkpoint import Checkpoint
from vapor.regressors.network_config import NetworkConfig
from vapor.regressors.scene_box import SceneBox
from vapor.regressors.variational import VariationalPoseRegressor

BOX = SceneBox((-1.0, 0.0, 2.0), (1.0, 10.0, 3.1))
SMALL = NetworkConfig(image_width=32, image_height=32, shortest_edge=36, feature_dim=16, latent_dim=4)


def make_checkpoint(config: NetworkConfig = SMALL, num_poses: int = 30) -> Checkpoint:
    torch.manual_seed(0)
    poses = Poses.exp(np.random.default_rng(0).standard_normal((num_poses, 6)))
    state = VariationalPoseRegressor(config, BOX).state_dict()
    calibration = Calibration(0.2, 0.1, replace(ErrorModel(), tail=3.5, floor=(0.1, 0.2, 0.3, 0.01, 0.02, 0.03)))
    return Checkpoint(config, BOX, calibration, poses, state, training={"data": ["a.mcap"], "seed": 3})
