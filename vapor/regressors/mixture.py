"""Mixture densities over camera poses: Gaussians in position times isotropic matrix-Fisher distributions in rotation.

Source: Deng et al., "Deep Bingham networks: dealing with uncertainty and ambiguity in pose estimation", IJCV 2022.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from vapor.regressors.base import DensityRegressor, Features, Images, Noise, PoseSamples, Positions, Rotations
from vapor.regressors.layers import count_below, normal_cdf, rodrigues, rotation_from_6d
from vapor.regressors.loss import pose_distance
from vapor.regressors.loss_config import LossConfig
from vapor.regressors.network_config import NetworkConfig
from vapor.regressors.scene_box import SceneBox

_ANGLES = 257  # points at which the distribution of a rotation's angle is tabulated
_STD_M = 0.02, 3.0  # narrowest and widest component of a mixture
_WIDTH_RAD = 0.02, 2.0
_RELAXATION = 0.05  # fraction of the loss that goes to the components other than the best one


class Components(NamedTuple):
    """k components for each of b images, with weights of sum 1; widths are metres along each axis, and radians."""

    log_weights: Float[Tensor, "b k"]
    translation: Float[Tensor, "b k 3"]
    rotation: Float[Tensor, "b k 3 3"]
    widths: Float[Tensor, "b k 2"]

    def log_density(
        self, translation: Float[Tensor, "b n 3"], rotation: Float[Tensor, "b n 3 3"]
    ) -> Float[Tensor, "b n"]:
        """Log density at n poses for each image, per m³ rad³."""
        with torch.autocast(translation.device.type, enabled=False):
            kernels = component_log_density(self.translation, self.rotation, self.widths, translation, rotation)
            return torch.logsumexp(self.log_weights[:, None] + kernels, dim=-1)


class MixtureDensity(DensityRegressor):
    """A regressor whose posterior is a mixture; subclasses define its components."""

    noise_dim = 8  # one for the component, three for the position, three for the axis and one for the angle

    @abstractmethod
    def components(self, feature: Float[Tensor, "b f"]) -> Components:
        """The mixtures of images with these features."""

    def sample(self, feature: Features, noise: Noise) -> PoseSamples:
        """Draws from the mixture."""
        log_weights, translation, rotation, widths = self.components(feature)
        which = count_below(log_weights.exp().cumsum(dim=-1), normal_cdf(noise[..., 0]))
        which = which.clamp_max(log_weights.shape[-1] - 1)
        row = torch.arange(len(which), device=which.device)[:, None]
        chosen = widths[row, which]
        position = translation[row, which] + chosen[..., :1] * noise[..., 1:4]
        quantile = normal_cdf(noise[..., 7])
        angle = _angle(widths[..., 1], which, quantile)
        axis = torch.nn.functional.normalize(noise[..., 4:7], dim=-1)
        return position, rotation[row, which] @ rodrigues(axis, angle)

    def log_density(
        self, feature: Features, translation: Float[Tensor, "b n 3"], rotation: Float[Tensor, "b n 3 3"]
    ) -> Float[Tensor, "b n"]:
        """Log density of the mixture, per m³ rad³."""
        return self.components(feature).log_density(translation, rotation)


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


def log_rotation_normaliser(width_rad: Tensor) -> Tensor:
    """Log ∫ exp((cos θ − 1)/h²) over SO(3), whose volume is 8π²; double precision, as two Bessel functions cancel."""
    k = 1.0 / width_rad.double().square()
    return torch.log(8 * torch.pi**2 * (torch.special.i0e(k) - torch.special.i1e(k))).to(width_rad.dtype)


def _angle(width_rad: Float[Tensor, "b k"], which: Tensor, quantile: Float[Tensor, "b m"]) -> Float[Tensor, "b m"]:
    """Angles of rotations from the identity, p(θ) ∝ exp((cos θ − 1)/h²)(1 − cos θ), from a table of its integral."""
    grid = torch.linspace(0.0, 1.0, _ANGLES, device=width_rad.device) * (9.0 * width_rad).clamp_max(torch.pi)[..., None]
    versine = 1.0 - torch.cos(grid)
    density = torch.exp(-versine / width_rad[..., None].square()) * versine
    sums = torch.cumsum(density[..., 1:] + density[..., :-1], dim=-1)
    sums = torch.cat([torch.zeros_like(sums[..., :1]), sums], dim=-1) / sums[..., -1:]
    row = torch.arange(len(which), device=which.device)[:, None]
    table, angles = sums[row, which], grid[row, which]
    above = count_below(table, quantile[..., None]).clamp(1, _ANGLES - 1)
    low, high = table.gather(-1, above - 1), table.gather(-1, above)
    between = (quantile[..., None] - low) / (high - low).clamp_min(1e-12)
    return torch.lerp(angles.gather(-1, above - 1), angles.gather(-1, above), between.clamp(0.0, 1.0))[..., 0]


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
        """The mixtures of images with these features."""
        with torch.autocast(feature.device.type, enabled=False):
            log_weights = torch.log_softmax(self.logits(feature), dim=-1)
            in_box = torch.sigmoid(self.translation(feature).unflatten(-1, (-1, 3)))
            rotation = rotation_from_6d(self.rotation_6d(feature).unflatten(-1, (-1, 6)))
            middle = torch.sigmoid(self.log_widths(feature).unflatten(-1, (-1, 2)))
            widths = torch.exp(self.least + (self.most - self.least) * middle)
            return Components(log_weights, torch.lerp(self.lower, self.upper, in_box), rotation, widths)

    def loss(
        self, images: Images, true_translation: Positions, true_rotation: Rotations, noise: Noise, config: LossConfig
    ) -> Float[Tensor, ""]:
        """Negative log likelihood of the best component and of its choice, and a little of the other components.

        Relaxed winner takes all: a mixture trained by its likelihood alone collapses to few components (Deng et al.).
        """
        log_weights, translation, rotation, widths = self.components(self.extract_features(images))
        truth = true_translation[:, None], true_rotation[:, None]
        with torch.autocast(images.device.type, enabled=False):
            log_likelihood = component_log_density(translation, rotation, widths, *truth)[:, 0]
        distance = pose_distance(translation, rotation, *truth, config, self.box)
        best = distance.argmin(dim=1, keepdim=True)
        winner = torch.zeros_like(log_weights).scatter_(1, best, 1.0)
        others = _RELAXATION / log_weights.shape[1]
        learning = (1.0 - _RELAXATION) * winner + others
        return -(learning * log_likelihood).sum(dim=1).mean() - log_weights.gather(1, best).mean()
