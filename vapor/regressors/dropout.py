"""A point regressor with dropout in use as well, whose draws are samples of the posterior: Bayesian PoseNet.

Source: Kendall and Cipolla, "Modelling uncertainty in deep learning for camera relocalization", ICRA 2016.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from scipy.special import ndtri
from torch import Tensor

from vapor.regressors.network_config import NetworkConfig
from vapor.regressors.point import PointRegressor
from vapor.regressors.scene_box import SceneBox


class DropoutRegressor(PointRegressor):
    """A pose for every draw of the units of the feature that are left out; trained as a point regressor is."""

    def __init__(self, config: NetworkConfig, box: SceneBox) -> None:
        super().__init__(config, box)
        self.noise_dim = config.feature_dim

    def sample(
        self, feature: Float[Tensor, "b f"], noise: Float[Tensor, "b m d"]
    ) -> tuple[Float[Tensor, "b m 3"], Float[Tensor, "b m 3 3"]]:
        """Poses without the units whose noise is among the least."""
        with torch.autocast(feature.device.type, enabled=False):
            dropped = self.config.dropout
            kept = noise > float(ndtri(dropped))
            return self.pose_map((feature / (1.0 - dropped))[:, None] * kept)
