"""The regressors that the variational one is measured against; all share its encoder, data and budget.

Sources: PoseNet, Kendall and Cipolla, "Geometric loss functions for camera pose regression with deep learning", CVPR
2017; Bayesian PoseNet, the same, "Modelling uncertainty in deep learning for camera relocalization", ICRA 2016; MapNet,
Brahmbhatt et al., "Geometry-aware learning of maps for camera localization", CVPR 2018; mixtures, Deng et al., "Deep
Bingham networks: dealing with uncertainty and ambiguity in pose estimation", IJCV 2022.
"""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor, nn

from vapor.flow import FlowRegressor
from vapor.network import (
    DensityRegressor,
    NetworkConfig,
    PoseMap,
    PoseRegressor,
    SceneBox,
    VariationalPoseRegressor,
    repeated,
    rotation_from_6d,
)

_STD_M = 0.02, 3.0  # narrowest and widest component of a mixture
_WIDTH_RAD = 0.02, 2.0
_ANGLES = 257  # points at which the distribution of a rotation's angle is tabulated


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


class MixtureRegressor(DensityRegressor):
    """A mixture density: Gaussians in position times isotropic matrix-Fisher distributions in rotation."""

    lower: Tensor
    upper: Tensor
    noise_dim = 8  # one for the component, three for the position, three for the axis and one for the angle

    def __init__(self, config: NetworkConfig, box: SceneBox) -> None:
        super().__init__(config, box)
        k = config.components
        self.logits = nn.Linear(config.feature_dim, k)
        self.translation = nn.Linear(config.feature_dim, 3 * k)
        self.rotation_6d = nn.Linear(config.feature_dim, 6 * k)
        self.log_widths = nn.Linear(config.feature_dim, 2 * k)
        self.register_buffer("lower", torch.tensor(box.lower), persistent=False)
        self.register_buffer("upper", torch.tensor(box.upper), persistent=False)

    def components(
        self, feature: Float[Tensor, "b f"]
    ) -> tuple[Float[Tensor, "b k"], Float[Tensor, "b k 3"], Float[Tensor, "b k 3 3"], Float[Tensor, "b k 2"]]:
        """Log weights, mean positions, mean rotations, and widths (metres, radians) of the components."""
        with torch.autocast(feature.device.type, enabled=False):
            log_weights = torch.log_softmax(self.logits(feature), dim=-1)
            share = torch.sigmoid(self.translation(feature).unflatten(-1, (-1, 3)))
            rotation = rotation_from_6d(self.rotation_6d(feature).unflatten(-1, (-1, 6)))
            least, most = feature.new_tensor([_STD_M, _WIDTH_RAD]).log().T
            middle = torch.sigmoid(self.log_widths(feature).unflatten(-1, (-1, 2)))
            widths = torch.exp(least + (most - least) * middle)
            return log_weights, torch.lerp(self.lower, self.upper, share), rotation, widths

    def sample(
        self, feature: Float[Tensor, "b f"], noise: Float[Tensor, "b m d"]
    ) -> tuple[Float[Tensor, "b m 3"], Float[Tensor, "b m 3 3"]]:
        """Draws from the mixture."""
        log_weights, translation, rotation, widths = self.components(feature)
        share = torch.special.ndtr(noise[..., 0])
        which = torch.searchsorted(log_weights.exp().cumsum(dim=-1).contiguous(), share.contiguous())
        which = which.clamp_max(log_weights.shape[-1] - 1)
        row = torch.arange(len(which), device=which.device)[:, None]
        chosen = widths[row, which]
        position = translation[row, which] + chosen[..., :1] * noise[..., 1:4]
        quantile = torch.special.ndtr(noise[..., 7])
        angle = _angle(widths[..., 1], which, quantile)
        axis = torch.nn.functional.normalize(noise[..., 4:7], dim=-1)
        return position, rotation[row, which] @ rodrigues(axis, angle)

    def log_density(
        self,
        feature: Float[Tensor, "b f"],
        translation: Float[Tensor, "b n 3"],
        rotation: Float[Tensor, "b n 3 3"],
    ) -> Float[Tensor, "b n"]:
        """Log density of the mixture, per m³ rad³."""
        log_weights, mean, mean_rotation, widths = self.components(feature)
        with torch.autocast(feature.device.type, enabled=False):
            kernels = component_log_density(mean, mean_rotation, widths, translation, rotation)
            return torch.logsumexp(log_weights[:, None] + kernels, dim=-1)


def component_log_density(
    mean: Float[Tensor, "b k 3"],
    mean_rotation: Float[Tensor, "b k 3 3"],
    widths: Float[Tensor, "b k 2"],
    translation: Float[Tensor, "b n 3"],
    rotation: Float[Tensor, "b n 3 3"],
) -> Float[Tensor, "b n k"]:
    """Log density of each component of a mixture at each pose, per m³ rad³; widths in metres and radians."""
    metres = torch.linalg.vector_norm(mean[:, None] - translation[:, :, None], dim=-1)
    apart = mean_rotation[:, None] - rotation[:, :, None]
    versine = 0.25 * torch.linalg.vector_norm(apart, dim=(-2, -1)).square()  # 1 − cos θ
    std_m, width_rad = widths[:, None].unbind(-1)
    log_position = -0.5 * (metres / std_m).square() - 3.0 * std_m.log() - 1.5 * math.log(2 * math.pi)
    return log_position - versine / width_rad.square() - log_rotation_normaliser(width_rad)


def make_regressor(config: NetworkConfig, box: SceneBox) -> PoseRegressor:
    """The regressor with the configured head, with random weights."""
    if config.head in ("variational", "deterministic"):
        return VariationalPoseRegressor(config, box)
    kinds = {"mixture": MixtureRegressor, "flow": FlowRegressor}
    return kinds.get(config.head, PointRegressor)(config, box)


def log_rotation_normaliser(width_rad: Tensor) -> Tensor:
    """Log ∫ exp((cos θ − 1)/h²) over SO(3), whose volume is 8π²; double precision, as two Bessel functions cancel."""
    k = 1.0 / width_rad.double().square()
    return torch.log(8 * torch.pi**2 * (torch.special.i0e(k) - torch.special.i1e(k))).to(width_rad.dtype)


def _angle(width_rad: Float[Tensor, "b k"], which: Tensor, quantile: Float[Tensor, "b m"]) -> Float[Tensor, "b m"]:
    """Angles of rotations from the identity, p(θ) ∝ exp((cos θ − 1)/h²)(1 − cos θ), from a table of its sums."""
    grid = torch.linspace(0.0, 1.0, _ANGLES, device=width_rad.device) * (9.0 * width_rad).clamp_max(torch.pi)[..., None]
    versine = 1.0 - torch.cos(grid)
    density = torch.exp(-versine / width_rad[..., None].square()) * versine
    sums = torch.cumsum(density[..., 1:] + density[..., :-1], dim=-1)
    sums = torch.cat([torch.zeros_like(sums[..., :1]), sums], dim=-1) / sums[..., -1:]
    row = torch.arange(len(which), device=which.device)[:, None]
    table, angles = sums[row, which].contiguous(), grid[row, which]
    above = torch.searchsorted(table, quantile[..., None].contiguous()).clamp(1, _ANGLES - 1)
    low, high = table.gather(-1, above - 1), table.gather(-1, above)
    share = (quantile[..., None] - low) / (high - low).clamp_min(1e-12)
    return torch.lerp(angles.gather(-1, above - 1), angles.gather(-1, above), share.clamp(0.0, 1.0))[..., 0]


def rodrigues(axis: Float[Tensor, "*batch 3"], angle: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch 3 3"]:
    """Rotations about unit vectors by angles in radians."""
    x, y, z = axis.unbind(-1)
    zero = torch.zeros_like(x)
    skew = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=-1).unflatten(-1, (3, 3))
    sin, versine = torch.sin(angle)[..., None, None], (1.0 - torch.cos(angle))[..., None, None]
    return torch.eye(3, dtype=axis.dtype, device=axis.device) + sin * skew + versine * (skew @ skew)
