"""Mixtures of Gaussians in position times isotropic matrix-Fisher distributions in rotation: draws and density."""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from vapor.regressors.base import DensityRegressor
from vapor.regressors.rotations import rodrigues
from vapor.regressors.traceable import count_below, normal_cdf

_ANGLES = 257  # points at which the distribution of a rotation's angle is tabulated


class Components(NamedTuple):
    """Of a mixture, k of them for each of b images.

    Attributes:
        log_weights: Log weights, whose exponentials add up to 1, (b, k).
        translation: Mean positions, metres, (b, k, 3).
        rotation: Mean rotations, (b, k, 3, 3).
        widths: Standard deviations of position along each axis, metres, and widths of rotation, radians, (b, k, 2).
    """

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
    """A regressor whose posterior is such a mixture; subclasses say what its components are."""

    noise_dim = 8  # one for the component, three for the position, three for the axis and one for the angle

    @abstractmethod
    def components(self, feature: Float[Tensor, "b f"]) -> Components:
        """The mixtures of images with these features (`extract_features`)."""

    def sample(
        self, feature: Float[Tensor, "b f"], noise: Float[Tensor, "b m d"]
    ) -> tuple[Float[Tensor, "b m 3"], Float[Tensor, "b m 3 3"]]:
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
        self,
        feature: Float[Tensor, "b f"],
        translation: Float[Tensor, "b n 3"],
        rotation: Float[Tensor, "b n 3 3"],
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
