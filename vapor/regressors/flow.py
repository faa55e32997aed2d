"""A density over camera poses that can be evaluated exactly: an autoregressive flow of monotone splines.

Sources: Durkan et al., "Neural spline flows", NeurIPS 2019 (rational-quadratic splines); Rezende et al., "Normalizing
flows on tori and spheres", ICML 2020 (splines on the circle).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from filtering.se3 import Poses
from vapor.regressors.base import DensityRegressor, Features, Images, Noise, PoseSamples, Positions, Rotations
from vapor.regressors.layers import count_below, normal_cdf, rodrigues
from vapor.regressors.loss_config import LossConfig
from vapor.regressors.network_config import NetworkConfig
from vapor.regressors.scene_box import SceneBox

_CIRCULAR = False, False, False, True, False, True  # x, y, z, a, c, g
_TARGET_NOISE_M, _TARGET_NOISE_RAD = 0.05, 0.05  # six of the former are the least margin of a scene box
_OCTAVES = 4  # of sines and cosines of a coordinate, on which the later ones depend
_LEAST_WIDTH, _LEAST_HEIGHT = 1e-3, 1e-5  # of a bin: sharpest density, and resolution of float32
_STEEPEST = 3.0  # greatest log ratio of the slope at a knot to the slopes of the bins beside it


class FlowRegressor(DensityRegressor):
    """A density: each of six coordinates in [0, 1) has a spline that depends on the image and the earlier coordinates.

    The coordinates are the position as fractions of the scene box's edges, and (a/2π, (c + 1)/2, g/2π) of the rotation
    R = W Rz(a) Ry(acos c) Rz(g) B. W and B permute axes, so c is the cosine between one axis of the world and one of
    the camera. In a, c and g the volume of SO(3) is uniform, 8π² in all. At |c| = 1 a and g are not unique;
    `choose_axes` keeps the poses of training away from there. Outside the box the density is 0.
    """

    lower: Tensor
    upper: Tensor
    world_axes: Tensor
    camera_axes: Tensor
    noise_dim = 6

    def __init__(self, config: NetworkConfig, box: SceneBox) -> None:
        super().__init__(config, box)
        width = config.hidden_width
        self.condition = nn.Linear(config.feature_dim, width)
        self.conditionals = nn.ModuleList(_Conditional(k, config) for k in range(6))
        self.register_buffer("lower", torch.tensor(box.lower), persistent=False)
        self.register_buffer("upper", torch.tensor(box.upper), persistent=False)
        # W and B: part of the weights, which mean nothing without them.
        self.register_buffer("world_axes", torch.eye(3))
        self.register_buffer("camera_axes", torch.eye(3))

    def initialise(self, training_poses: Poses, *, log_variance: float) -> None:
        """Choose the axes by the training poses."""
        self.choose_axes(training_poses)

    @torch.no_grad()
    def choose_axes(self, poses: Poses) -> None:
        """Take the axes of world and camera whose largest |cosine| over poses (n,) is the least."""
        world, camera = np.unravel_index(np.abs(poses.rotation).max(axis=0).argmin(), (3, 3))
        eye = torch.eye(3)
        self.world_axes.copy_(eye.roll(int(world) + 1, 0))  # its last column is the axis of the world
        self.camera_axes.copy_(eye.roll(int(camera) + 1, 1))  # its last row is the axis of the camera

    def sample(self, feature: Features, noise: Noise) -> PoseSamples:
        """Draws by the inverse splines, coordinate after coordinate."""
        with torch.autocast(feature.device.type, enabled=False):
            condition = self.condition(feature)[:, None]
            uniform = normal_cdf(noise)
            known: list[Tensor] = []
            for k, conditional in enumerate(self.conditionals):
                spline = conditional(condition, _waves(known, uniform), uniform)
                known.append(spline.inverse(uniform[..., k]))
            return self._pose(torch.stack(known, dim=-1))

    def log_density(
        self, feature: Features, translation: Float[Tensor, "b n 3"], rotation: Float[Tensor, "b n 3 3"]
    ) -> Float[Tensor, "b n"]:
        """Log density, per m³ rad³, from slopes of splines and volumes of box and SO(3); −∞ outside the box."""
        with torch.autocast(feature.device.type, enabled=False):
            condition = self.condition(feature)[:, None]
            unit = self._coordinates(translation, rotation)
            inside = ((unit >= 0.0) & (unit <= 1.0)).all(dim=-1)
            known = unit.clamp(0.0, 1.0).unbind(dim=-1)
            slopes = [
                conditional(condition, _waves(known[:k], unit), unit).log_slope(known[k])
                for k, conditional in enumerate(self.conditionals)
            ]
            log_volume = (self.upper - self.lower).log().sum() + math.log(8 * math.pi**2)
            return torch.where(inside, torch.stack(slopes).sum(dim=0) - log_volume, -torch.inf)

    def loss(
        self, images: Images, true_translation: Positions, true_rotation: Rotations, noise: Noise, config: LossConfig
    ) -> Float[Tensor, ""]:
        """Negative log density of the true poses, nats, with a little noise: at points it would grow without bounds."""
        feature = self.extract_features(images)
        truth = true_translation[:, None], true_rotation[:, None]
        with torch.autocast(images.device.type, enabled=False):
            turn = _TARGET_NOISE_RAD * noise[..., 3:]
            angle = torch.linalg.vector_norm(turn, dim=-1).clamp_min(1e-9)
            translation = truth[0] + _TARGET_NOISE_M * noise[..., :3]
            rotation = truth[1] @ rodrigues(turn / angle[..., None], angle)
        return -self.log_density(feature, translation, rotation).mean()

    def _coordinates(
        self, translation: Float[Tensor, "*batch 3"], rotation: Float[Tensor, "*batch 3 3"]
    ) -> Float[Tensor, "*batch 6"]:
        in_box = (translation - self.lower) / (self.upper - self.lower)
        polar = self.world_axes.mT @ rotation @ self.camera_axes.mT
        turns = torch.stack(
            [
                torch.atan2(polar[..., 1, 2], polar[..., 0, 2]) / (2 * math.pi) % 1.0,
                (0.5 + 0.5 * polar[..., 2, 2]).clamp(0.0, 1.0),
                torch.atan2(polar[..., 2, 1], -polar[..., 2, 0]) / (2 * math.pi) % 1.0,
            ],
            dim=-1,
        )
        return torch.cat([in_box, turns], dim=-1)

    def _pose(self, unit: Float[Tensor, "*batch 6"]) -> tuple[Float[Tensor, "*batch 3"], Float[Tensor, "*batch 3 3"]]:
        a, c, g = unit[..., 3:].unbind(dim=-1)
        c = 2.0 * c - 1.0
        s = (1.0 - c.square()).clamp_min(0.0).sqrt()
        zero, one = torch.zeros_like(c), torch.ones_like(c)
        tilt = torch.stack([c, zero, s, zero, one, zero, -s, zero, c], dim=-1).unflatten(-1, (3, 3))
        polar = _about_z(2 * math.pi * a) @ tilt @ _about_z(2 * math.pi * g)
        return torch.lerp(self.lower, self.upper, unit[..., :3]), self.world_axes @ polar @ self.camera_axes


class _Conditional(nn.Module):
    """The spline of one coordinate from the image and the earlier coordinates."""

    def __init__(self, index: int, config: NetworkConfig) -> None:
        super().__init__()
        self.circular = _CIRCULAR[index]
        width = config.hidden_width
        self.first = nn.Linear(width, width)
        self.before = nn.Linear(2 * _OCTAVES * index, width, bias=False) if index else None
        self.hidden = nn.ModuleList(nn.Linear(width, width) for _ in range(config.hidden_layers))
        self.last = nn.Linear(width, 3 * config.components)

    def forward(
        self, condition: Float[Tensor, "b 1 w"], before: Float[Tensor, "b n e"], like: Float[Tensor, "b n f"]
    ) -> Spline:
        hidden = self.first(condition)
        # While a network is traced, only arithmetic keeps n open: an empty tensor would have a constant shape.
        hidden = hidden + (0.0 * like[..., :1] if self.before is None else self.before(before))
        hidden = functional.relu(hidden)
        for layer in self.hidden:
            hidden = functional.relu(layer(hidden))
        return Spline.of(self.last(hidden), circular=self.circular)


def _waves(known: Sequence[Tensor], like: Float[Tensor, "b n 6"]) -> Float[Tensor, "b n e"]:
    """Sines and cosines of the known coordinates, 8 for each; circular coordinates are whole turns."""
    found = [like[..., :0]]
    for coordinate, circular in zip(known, _CIRCULAR, strict=False):
        octaves = 2.0 ** torch.arange(_OCTAVES, device=like.device, dtype=like.dtype)
        phase = (2 * math.pi if circular else math.pi) * coordinate[..., None] * octaves
        found += [phase.sin(), phase.cos()]
    return torch.cat(found, dim=-1)


def _about_z(angle: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch 3 3"]:
    cos, sin, zero, one = angle.cos(), angle.sin(), torch.zeros_like(angle), torch.ones_like(angle)
    return torch.stack([cos, -sin, zero, sin, cos, zero, zero, zero, one], dim=-1).unflatten(-1, (3, 3))


@dataclass(frozen=True)
class Spline:
    """Monotone maps of [0, 1] onto itself: rational quadratics between knots x with images y."""

    x: Float[Tensor, "b n k"]
    y: Float[Tensor, "b n k"]
    slope: Float[Tensor, "b n k"]

    @staticmethod
    def of(raw: Float[Tensor, "b n r"], *, circular: bool) -> Spline:
        """A spline from any numbers, three for each bin; on a circle both ends have the same slope."""
        widths, heights, steepness = raw.unflatten(-1, (3, -1)).unbind(dim=-2)
        widths, heights = _fractions(widths, _LEAST_WIDTH), _fractions(heights, _LEAST_HEIGHT)
        log_slope = (heights / widths).log()
        before = log_slope.roll(1, dims=-1) if circular else torch.cat([log_slope[..., :1], log_slope[..., :-1]], -1)
        at_knots = 0.5 * (before + log_slope) + _STEEPEST * torch.tanh(steepness / _STEEPEST)
        last = at_knots[..., :1] if circular else log_slope[..., -1:]
        return Spline(_knots(widths), _knots(heights), torch.cat([at_knots, last], dim=-1).exp())

    def log_slope(self, x: Float[Tensor, "b n"]) -> Float[Tensor, "b n"]:
        """Log dy/dx: the log density of x where y is uniform."""
        x0, _, width, height, first, second = self._bin(self.x, x)
        mean = height / width
        inside = ((x - x0) / width).clamp(0.0, 1.0)
        both = inside * (1.0 - inside)
        above = second * inside.square() + 2 * mean * both + first * (1.0 - inside).square()
        return 2 * mean.log() + above.log() - 2 * (mean + (first + second - 2 * mean) * both).log()

    def inverse(self, y: Float[Tensor, "b n"]) -> Float[Tensor, "b n"]:
        """The x of each y."""
        x0, y0, width, height, first, second = self._bin(self.y, y)
        mean, rise = height / width, (y - y0).clamp_min(0.0)
        bend = rise * (first + second - 2 * mean)
        a, b, c = height * (mean - first) + bend, height * first - bend, -mean * rise
        inside = 2 * c / (-b - (b.square() - 4 * a * c).clamp_min(0.0).sqrt())
        return (x0 + width * inside.clamp(0.0, 1.0)).clamp(0.0, 1.0)

    def _bin(self, knots: Tensor, at: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor]:
        """x, y, width, height, and the slopes at both ends of the bin in which `at` lies among the knots."""
        left = count_below(knots[..., 1:-1].detach(), at[..., None], or_equal=True)
        (x0, x1), (y0, y1), (first, second) = (
            (values.gather(-1, left)[..., 0], values.gather(-1, left + 1)[..., 0])
            for values in (self.x, self.y, self.slope)
        )
        return x0, y0, x1 - x0, y1 - y0, first, second


def _fractions(raw: Float[Tensor, "*batch k"], least: float) -> Float[Tensor, "*batch k"]:
    """Positive numbers of sum 1, none below `least` (or half of an equal fraction, where that is less)."""
    bins = raw.shape[-1]
    least = min(least, 0.5 / bins)
    return least + (1.0 - bins * least) * torch.softmax(raw, dim=-1)


def _knots(fractions: Float[Tensor, "*batch k"]) -> Float[Tensor, "*batch l"]:
    """From 0 to 1, l = k + 1."""
    sums = fractions[..., :-1].cumsum(dim=-1)
    zero = 0.0 * sums[..., :1]  # by arithmetic, which keeps sizes open while a network is traced
    return torch.cat([zero, sums, zero + 1.0], dim=-1)
