"""The variational regressor without its sampling: the pose of the latent mean, as an ablation."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from vapor.regressors.loss import Loss, LossConfig, pose_distance
from vapor.regressors.network_config import NetworkConfig
from vapor.regressors.pose_map import repeated
from vapor.regressors.scene_box import SceneBox
from vapor.regressors.variational import VariationalPoseRegressor


class DeterministicPoseRegressor(VariationalPoseRegressor):
    """The same layers, of which the latent variance is used for nothing; all samples of an image are one pose."""

    def __init__(self, config: NetworkConfig, box: SceneBox) -> None:
        super().__init__(config, box)
        self.noise_dim = 0

    def sample(
        self, feature: Float[Tensor, "b f"], noise: Float[Tensor, "b m d"]
    ) -> tuple[Float[Tensor, "b m 3"], Float[Tensor, "b m 3 3"]]:
        """The pose map of z = μ, m times."""
        mean, _ = self.latent(feature)
        return repeated(self.decode(mean), noise.shape[1])

    def loss(
        self,
        images: Float[Tensor, "b 3 h w"],
        true_translation: Float[Tensor, "b 3"],
        true_rotation: Float[Tensor, "b 3 3"],
        noise: Float[Tensor, "b m d"],
        config: LossConfig,
    ) -> Loss:
        """Mean d_pose over the batch."""
        mean, _ = self.encode(images)
        distance = pose_distance(*self.decode(mean), true_translation, true_rotation, config, self.box).mean()
        return Loss(distance, torch.zeros_like(distance), distance.detach())

    def samples_in_training(self, scheduled: int) -> int:
        """One, as there are no others."""
        return 1
