"""A mixture density over camera poses, all of whose components follow from the image's feature.

Source: Deng et al., "Deep Bingham networks: dealing with uncertainty and ambiguity in pose estimation", IJCV 2022.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

from vapor.regressors.loss import Loss, LossConfig, pose_distance
from vapor.regressors.mixture_density import Components, MixtureDensity, component_log_density
from vapor.regressors.network_config import NetworkConfig
from vapor.regressors.rotations import rotation_from_6d
from vapor.regressors.scene_box import SceneBox

_STD_M = 0.02, 3.0  # narrowest and widest component of a mixture
_WIDTH_RAD = 0.02, 2.0


class MixtureRegressor(MixtureDensity):
    """A mixture density: Gaussians in position times isotropic matrix-Fisher distributions in rotation."""

    lower: Tensor
    upper: Tensor
    least: Tensor
    most: Tensor

    def __init__(self, config: NetworkConfig, box: SceneBox) -> None:
        super().__init__(config, box)
        k = config.components
        self.logits = nn.Linear(config.feature_dim, k)
        self.translation = nn.Linear(config.feature_dim, 3 * k)
        self.rotation_6d = nn.Linear(config.feature_dim, 6 * k)
        self.log_widths = nn.Linear(config.feature_dim, 2 * k)
        self.register_buffer("lower", torch.tensor(box.lower), persistent=False)
        self.register_buffer("upper", torch.tensor(box.upper), persistent=False)
        least, most = torch.tensor([_STD_M, _WIDTH_RAD]).log().T
        self.register_buffer("least", least, persistent=False)
        self.register_buffer("most", most, persistent=False)

    def components(self, feature: Float[Tensor, "b f"]) -> Components:
        """The components of images with these features."""
        with torch.autocast(feature.device.type, enabled=False):
            log_weights = torch.log_softmax(self.logits(feature), dim=-1)
            in_box = torch.sigmoid(self.translation(feature).unflatten(-1, (-1, 3)))
            rotation = rotation_from_6d(self.rotation_6d(feature).unflatten(-1, (-1, 6)))
            middle = torch.sigmoid(self.log_widths(feature).unflatten(-1, (-1, 2)))
            widths = torch.exp(self.least + (self.most - self.least) * middle)
            return Components(log_weights, torch.lerp(self.lower, self.upper, in_box), rotation, widths)

    def loss(
        self,
        images: Float[Tensor, "b 3 h w"],
        true_translation: Float[Tensor, "b 3"],
        true_rotation: Float[Tensor, "b 3 3"],
        noise: Float[Tensor, "b m d"],
        config: LossConfig,
    ) -> Loss:
        """Negative log likelihood of the component that fits best, a little of the others', and which one it is.

        Relaxed winner takes all: a mixture trained by its likelihood alone collapses to few components (Deng et al.).
        """
        log_weights, translation, rotation, widths = self.components(self.extract_features(images))
        truth = true_translation[:, None], true_rotation[:, None]
        with torch.autocast(images.device.type, enabled=False):
            log_likelihood = component_log_density(translation, rotation, widths, *truth)[:, 0]
        distance = pose_distance(translation, rotation, *truth, config, self.box)
        best = distance.argmin(dim=1, keepdim=True)
        winner = torch.zeros_like(log_weights).scatter_(1, best, 1.0)
        others = config.relaxation / log_weights.shape[1]
        learning = (1.0 - config.relaxation) * winner + others
        total = -(learning * log_likelihood).sum(dim=1).mean() - log_weights.gather(1, best).mean()
        nearest = distance.gather(1, best).mean()
        return Loss(total, torch.zeros_like(nearest), nearest.detach())
