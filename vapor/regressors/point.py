"""One pose an image: PoseNet, MapNet where pairs of images are compared, and Bayesian PoseNet with dropout.

Sources: Bayesian PoseNet, Kendall and Cipolla, "Modelling uncertainty in deep learning for camera relocalization", ICRA
2016; PoseNet, Kendall and Cipolla, "Geometric loss functions for camera pose regression with deep learning", CVPR
2017; MapNet, Brahmbhatt et al., "Geometry-aware learning of maps for camera localization", CVPR 2018.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from scipy.special import ndtri
from torch import Tensor, nn

from vapor.regressors.base import Features, Images, Noise, PoseRegressor, PoseSamples, Positions, Rotations
from vapor.regressors.layers import PoseMap, repeated
from vapor.regressors.loss import pose_errors
from vapor.regressors.loss_config import LossConfig
from vapor.regressors.network_config import NetworkConfig
from vapor.regressors.scene_box import SceneBox


class PointRegressor(PoseRegressor):
    """One pose an image; the weights of errors of position and rotation in the loss are learned, too."""

    learns_relative_poses = True

    def __init__(self, config: NetworkConfig, box: SceneBox) -> None:
        super().__init__(config, box)
        self.pose_map = PoseMap(nn.Identity(), config.feature_dim, box)
        # s of Kendall and Cipolla, of position and of rotation, with their initial values; theirs is of quaternions.
        self.log_scale = nn.Parameter(torch.tensor([0.0, -3.0]))
        self.noise_dim = 0

    def sample(self, feature: Features, noise: Noise) -> PoseSamples:
        """The pose, m times."""
        with torch.autocast(feature.device.type, enabled=False):
            return repeated(self.pose_map(feature), noise.shape[1])

    def loss(
        self, images: Images, true_translation: Positions, true_rotation: Rotations, noise: Noise, config: LossConfig
    ) -> Float[Tensor, ""]:
        """Errors e of position and rotation, weighted by learned scales s: |e| exp(−s) + s (Kendall and Cipolla).

        `relative` adds errors of the pose of each image of the second half of the batch as seen from its partner in the
        first half, with the same scales (Brahmbhatt et al., whose scales and norms may differ).
        """
        translation, rotation = self(images, noise)
        poses = translation[:, 0], rotation[:, 0]
        truth = true_translation, true_rotation

        def weighted(errors: tuple[Tensor, Tensor]) -> Tensor:
            scale = self.log_scale
            return (torch.stack(errors, dim=-1) * torch.exp(-scale) + scale).sum(dim=-1).mean()

        total = weighted(pose_errors(poses, truth, config, self.box))
        if config.relative > 0.0:
            half = len(images) // 2
            with torch.autocast(images.device.type, enabled=False):  # bfloat16 would round metres to centimetres
                axes = true_rotation[:half]
                errors = pose_errors(_relative(*poses, half, axes), _relative(*truth, half, axes), config, self.box)
            total = total + config.relative * weighted(errors)
        return total


def _relative(translation: Tensor, rotation: Tensor, half: int, axes: Tensor) -> tuple[Tensor, Tensor]:
    """Poses of the second half as seen from the first, turned by `axes` to the world's axes."""
    back = rotation[:half].mT
    shift = (axes @ back @ (translation[half : 2 * half] - translation[:half])[..., None])[..., 0]
    return shift, back @ rotation[half : 2 * half]


class DropoutRegressor(PointRegressor):
    """A pose for every draw of the units of the feature that are left out; trained like a point regressor."""

    def __init__(self, config: NetworkConfig, box: SceneBox) -> None:
        super().__init__(config, box)
        self.noise_dim = config.feature_dim

    def sample(self, feature: Features, noise: Noise) -> PoseSamples:
        """Poses without the units whose noise is among the least."""
        with torch.autocast(feature.device.type, enabled=False):
            dropped = self.config.dropout
            kept = noise > float(ndtri(dropped))
            return self.pose_map((feature / (1.0 - dropped))[:, None] * kept)
