"""Models with random weights, to be timed: they take as long as trained ones."""

from __future__ import annotations

import numpy as np

from filtering.se3 import Poses
from vapor.checkpoints.calibration import Calibration
from vapor.checkpoints.checkpoint import Checkpoint
from vapor.regressors.network_config import NetworkConfig, make_regressor
from vapor.regressors.scene_box import SceneBox

_REMEMBERED = 1000  # images


def untrained(config: NetworkConfig) -> Checkpoint:
    """A model with random weights of seed 0, and random images in memory where it has one."""
    import torch

    box = SceneBox((-5.0, -5.0, 0.0), (5.0, 5.0, 3.0))
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        network = make_regressor(config, box)
        if (recalling := network.recalling) is not None:
            features = torch.randn(_REMEMBERED, len(recalling.centre))
            recalling.remember(features, torch.zeros(_REMEMBERED, 3), torch.eye(3).repeat(_REMEMBERED, 1, 1))
    return Checkpoint(config, box, Calibration(), Poses.exp(np.zeros((1, 6))), network.state_dict(), network.memory)
