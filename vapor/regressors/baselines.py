"""The regressors that the variational one is measured against; all share its encoder, data and budget.

Sources: PoseNet, Kendall and Cipolla, "Geometric loss functions for camera pose regression with deep learning", CVPR
2017; Bayesian PoseNet, the same, "Modelling uncertainty in deep learning for camera relocalization", ICRA 2016; MapNet,
Brahmbhatt et al., "Geometry-aware learning of maps for camera localization", CVPR 2018; mixtures, Deng et al., "Deep
Bingham networks: dealing with uncertainty and ambiguity in pose estimation", IJCV 2022.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

from vapor.regressors.base import (
    NetworkConfig,
    PoseMap,
    PoseRegressor,
    SceneBox,
    VariationalPoseRegressor,
    repeated,
    rotation_from_6d,
)
from vapor.regressors.flow import FlowRegressor
from vapor.regressors.mixture import Components, MixtureDensity
from vapor.regressors.retrieval import RetrievalRegressor

_STD_M = 0.02, 3.0  # narrowest and widest component of a mixture
_WIDTH_RAD = 0.02, 2.0


class PointRegressor(PoseRegressor):
    """One pose an image, and how much errors of position and of rotation count in training, which is learned too."""

    def __init__(self, config: NetworkConfig, box: SceneBox) -> None:
        super().__init__(config, box)
        self.pose_map = PoseMap(nn.Identity(), config.feature_dim, box)
        # s of Kendall and Cipolla, of position and of rotation, with their initial values; theirs is of quaternions.
        self.log_scale = nn.Parameter(torch.tensor([0.0, -3.0]))
        self.noise_dim = config.feature_dim if config.head == "dropout" else 0

    def forward(
        self, images: Float[Tensor, "b 3 h w"], noise: Float[Tensor, "b m d"]
    ) -> tuple[Float[Tensor, "b m 3"], Float[Tensor, "b m 3 3"]]:
        """The pose, m times; with dropout as many draws of it, units whose noise is among the least left out."""
        feature = self.describe(images)
        with torch.autocast(feature.device.type, enabled=False):
            if not self.noise_dim:
                return repeated(self.pose_map(feature), noise.shape[1])
            share = self.config.dropout
            kept = noise > torch.special.ndtri(torch.tensor(share, dtype=torch.float64))
            return self.pose_map((feature / (1.0 - share))[:, None] * kept)


class MixtureRegressor(MixtureDensity):
    """A mixture density: Gaussians in position times isotropic matrix-Fisher distributions in rotation."""

    lower: Tensor
    upper: Tensor

    def __init__(self, config: NetworkConfig, box: SceneBox) -> None:
        super().__init__(config, box)
        k = config.components
        self.logits = nn.Linear(config.feature_dim, k)
        self.translation = nn.Linear(config.feature_dim, 3 * k)
        self.rotation_6d = nn.Linear(config.feature_dim, 6 * k)
        self.log_widths = nn.Linear(config.feature_dim, 2 * k)
        self.register_buffer("lower", torch.tensor(box.lower), persistent=False)
        self.register_buffer("upper", torch.tensor(box.upper), persistent=False)

    def components(self, feature: Float[Tensor, "b f"]) -> Components:
        """What the feature says of each component."""
        with torch.autocast(feature.device.type, enabled=False):
            log_weights = torch.log_softmax(self.logits(feature), dim=-1)
            share = torch.sigmoid(self.translation(feature).unflatten(-1, (-1, 3)))
            rotation = rotation_from_6d(self.rotation_6d(feature).unflatten(-1, (-1, 6)))
            least, most = feature.new_tensor([_STD_M, _WIDTH_RAD]).log().T
            middle = torch.sigmoid(self.log_widths(feature).unflatten(-1, (-1, 2)))
            widths = torch.exp(least + (most - least) * middle)
            return Components(log_weights, torch.lerp(self.lower, self.upper, share), rotation, widths)


def make_regressor(config: NetworkConfig, box: SceneBox) -> PoseRegressor:
    """The regressor with the configured head, with random weights."""
    if config.head in ("variational", "deterministic"):
        return VariationalPoseRegressor(config, box)
    kinds = {"mixture": MixtureRegressor, "flow": FlowRegressor, "retrieval": RetrievalRegressor}
    return kinds.get(config.head, PointRegressor)(config, box)
