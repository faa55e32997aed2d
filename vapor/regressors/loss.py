"""The training losses: that of the variational regressor (KL divergence, winners take all), and the baselines'."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from filtering.errors import VaporTrackError, require_within
from vapor.regressors.base import PoseRegressor, SceneBox, VariationalPoseRegressor, sample_latent
from vapor.regressors.baselines import MixtureRegressor, PointRegressor
from vapor.regressors.flow import FlowRegressor
from vapor.regressors.mixture import component_log_density, rodrigues
from vapor.regressors.retrieval import RetrievalRegressor

PositionUnit = Literal["metre", "box"]

_EVEN = 0.05  # retrieval: share of the density that is spread over the scene
_LARGEST_WEIGHT = 10.0  # of an axis along which cameras hardly move, whose errors are noise


@dataclass(frozen=True)
class LossConfig:
    """Weights of the loss; the defaults of α, β and λ are the paper's, λ for its ambiguous scenes."""

    lambda_translation: float = 5.0
    """λ_t, per metre; with `position_unit` box per metre along the longest edge."""
    position_unit: PositionUnit = "box"
    """Unit of errors of position: the metre, as in the paper; or box, which multiplies the error along each axis by the
    longest edge of the scene's box over its own edge, up to ten, so that what varies little, such as a height, is not
    drowned by what varies much. Of a mixture it says which component is best, of a flow nothing."""
    lambda_rotation: float = 2.0
    """λ_r, per unit of ‖R̂ − R‖_F."""
    alpha: float = 0.2
    """Share of the samples, the nearest to the true pose, that learn from it; never less than one of them."""
    beta: float = 0.01
    """Weight of the KL divergence."""
    num_samples: int = 256
    """M, posterior samples per image; the paper draws 1000."""
    relative: float = 0.0
    """Weight of relative poses between pairs of images beside that of poses, for point regressors: MapNet."""
    pair_gap: int = 10
    """relative: images from one of a pair to the other, at most."""
    relaxation: float = 0.05
    """mixture: share of the loss that the components beside the best one have."""
    target_noise_m: float = 0.05
    """flow: standard deviation of noise on true positions along each axis, metres: a density of points is without
    bounds, and what lies beside the points is never learned."""
    target_noise_rad: float = 0.05
    """flow: standard deviation of noise on true rotations about each axis, radians."""

    def __post_init__(self) -> None:
        if self.position_unit not in get_args(PositionUnit):
            units = get_args(PositionUnit)
            raise VaporTrackError(f"loss: position_unit is {self.position_unit!r}, expected one of {units}")
        require_within(
            self,
            lambda_translation=(0.0, 1e9),
            lambda_rotation=(0.0, 1e9),
            alpha=(1e-6, 1.0),
            beta=(0.0, 1e9),
            num_samples=(1, 10**6),
            relative=(0.0, 1e9),
            pair_gap=(1, 10**6),
            relaxation=(0.0, 1.0),
            target_noise_m=(0.0, 0.05),  # six of them are the least margin of a scene box
            target_noise_rad=(0.0, 1.0),
        )

    @property
    def num_winners(self) -> int:
        """⌊αM⌋, at least 1."""
        return max(1, int(self.alpha * self.num_samples + 1e-9))


@dataclass(frozen=True)
class Loss:
    """The loss of one batch and its parts, scalars.

    Attributes:
        total: What is minimised; carries the gradient.
        kl: Mean KL divergence over the batch, nats; 0 where there is no latent Gaussian.
        distance: Mean d_pose of those that learn: the winners, the one pose, or the best component; of a flow, of a
            sample.
    """

    total: Tensor
    kl: Tensor
    distance: Tensor


def kl_divergence(mean: Float[Tensor, "b d"], log_variance: Float[Tensor, "b d"]) -> Float[Tensor, " b"]:
    """KL(N(μ, diag σ²) ‖ N(0, I)) in nats: ½ Σ (μ² + σ² − 1 − log σ²)."""
    return 0.5 * (mean.square() + log_variance.exp() - 1.0 - log_variance).sum(dim=-1)


def pose_distance(
    translation: Float[Tensor, "*batch 3"],
    rotation: Float[Tensor, "*batch 3 3"],
    true_translation: Float[Tensor, "*#batch 3"],
    true_rotation: Float[Tensor, "*#batch 3 3"],
    config: LossConfig,
    box: SceneBox,
) -> Float[Tensor, "*batch"]:
    """d_pose = λ_t ‖t̂ − t‖₂ + λ_r ‖R̂ − R‖_F; true poses broadcast.

    The box, that of the scene, gives the unit of positions where it is not metres.
    """
    position, chord = _errors((translation, rotation), (true_translation, true_rotation), config, box)
    return config.lambda_translation * position + config.lambda_rotation * chord


def training_loss(
    network: PoseRegressor,
    images: Float[Tensor, "b 3 h w"],
    true_translation: Float[Tensor, "b 3"],
    true_rotation: Float[Tensor, "b 3 3"],
    noise: Float[Tensor, "b m d"],
    config: LossConfig,
) -> Loss:
    """The loss that a network's head is trained with, but for a retrieval regressor's (`retrieval_loss`).

    Args:
        network: In training mode.
        images: Normalised images; with `relative`, the two halves of the batch are pairs.
        true_translation: Metres, of world_from_camera.
        true_rotation: Rotation matrices of world_from_camera.
        noise: Standard normal, d = `network.noise_dim`; m = `num_samples` for the variational head, else 1.
        config: Weights of the loss.
    """
    truth = true_translation, true_rotation
    if isinstance(network, MixtureRegressor):
        return mixture_loss(network, images, *truth, config)
    if isinstance(network, FlowRegressor):
        return flow_loss(network, images, *truth, noise, config)
    if isinstance(network, PointRegressor):
        return point_loss(network, images, *truth, noise, config)
    if not isinstance(network, VariationalPoseRegressor):
        raise TypeError(f"{type(network).__name__} has no loss")
    if network.noise_dim:
        return variational_loss(network, images, *truth, noise, config)
    mean, _ = network.encode(images)
    distance = pose_distance(*network.decode(mean), *truth, config, network.box).mean()
    return Loss(distance, torch.zeros_like(distance), distance.detach())


def variational_loss(
    network: VariationalPoseRegressor,
    images: Float[Tensor, "b 3 h w"],
    true_translation: Float[Tensor, "b 3"],
    true_rotation: Float[Tensor, "b 3 3"],
    noise: Float[Tensor, "b m d"],
    config: LossConfig,
) -> Loss:
    """β KL + mean d_pose over the batch and, of each image, the ⌊αM⌋ samples nearest to its true pose.

    All M samples are mapped without gradient first, to find the winners; only the winners are mapped again with
    gradient. The losers' gradient is zero, so this is the gradient of mapping all of them, for a fraction of the work.

    Args:
        network: In training mode.
        images: Normalised images.
        true_translation: Metres, of world_from_camera.
        true_rotation: Rotation matrices of world_from_camera.
        noise: ε of M = config.num_samples latent samples an image.
        config: Weights of the loss.
    """
    mean, log_variance = network.encode(images)
    truth = true_translation[:, None], true_rotation[:, None]
    with torch.no_grad():
        distance = pose_distance(*network.decode(sample_latent(mean, log_variance, noise)), *truth, config, network.box)
        winners = distance.topk(config.num_winners, dim=1, largest=False, sorted=False).indices
        winning_noise = noise.gather(1, winners[..., None].expand(-1, -1, noise.shape[-1]))
    latent = sample_latent(mean, log_variance, winning_noise)
    nearest = pose_distance(*network.decode(latent), *truth, config, network.box).mean()
    kl = kl_divergence(mean, log_variance).mean()
    return Loss(config.beta * kl + nearest, kl.detach(), nearest.detach())


def point_loss(
    network: PointRegressor,
    images: Float[Tensor, "b 3 h w"],
    true_translation: Float[Tensor, "b 3"],
    true_rotation: Float[Tensor, "b 3 3"],
    noise: Float[Tensor, "b 1 d"],
    config: LossConfig,
) -> Loss:
    """Errors of position and rotation, weighted by scales that are learned: |e| exp(−s) + s (Kendall and Cipolla).

    With `relative`, the same of the pose of each image of the second half of the batch as seen from its partner in the
    first half, weighted by the same scales (Brahmbhatt et al., whose scales and norms may be others).
    """
    translation, rotation = network(images, noise)
    poses = translation[:, 0], rotation[:, 0]
    truth = true_translation, true_rotation

    def weighted(errors: tuple[Tensor, Tensor]) -> Tensor:
        scale = network.log_scale
        return (torch.stack(errors, dim=-1) * torch.exp(-scale) + scale).sum(dim=-1).mean()

    total = weighted(_errors(poses, truth, config, network.box))
    if config.relative > 0.0:
        half = len(images) // 2
        with torch.autocast(images.device.type, enabled=False):  # bfloat16 would round metres to centimetres
            axes = true_rotation[:half]
            errors = _errors(_relative(*poses, half, axes), _relative(*truth, half, axes), config, network.box)
        total = total + config.relative * weighted(errors)
    distance = pose_distance(*poses, *truth, config, network.box).mean()
    return Loss(total, torch.zeros_like(distance), distance.detach())


def mixture_loss(
    network: MixtureRegressor,
    images: Float[Tensor, "b 3 h w"],
    true_translation: Float[Tensor, "b 3"],
    true_rotation: Float[Tensor, "b 3 3"],
    config: LossConfig,
) -> Loss:
    """Negative log likelihood of the component that fits best, a little of the others', and which one it is.

    Relaxed winner takes all: a mixture trained by its likelihood alone collapses to few components (Deng et al.).
    """
    log_weights, translation, rotation, widths = network.components(network.describe(images))
    truth = true_translation[:, None], true_rotation[:, None]
    with torch.autocast(images.device.type, enabled=False):
        log_likelihood = component_log_density(translation, rotation, widths, *truth)[:, 0]
    distance = pose_distance(translation, rotation, *truth, config, network.box)
    best = distance.argmin(dim=1, keepdim=True)
    winner = torch.zeros_like(log_weights).scatter_(1, best, 1.0)
    others = config.relaxation / log_weights.shape[1]
    share = (1.0 - config.relaxation) * winner + others
    total = -(share * log_likelihood).sum(dim=1).mean() - log_weights.gather(1, best).mean()
    nearest = distance.gather(1, best).mean()
    return Loss(total, torch.zeros_like(nearest), nearest.detach())


def retrieval_loss(
    network: RetrievalRegressor,
    feature: Float[Tensor, "b f"],
    true_translation: Float[Tensor, "b 3"],
    true_rotation: Float[Tensor, "b 3 3"],
    hidden: Bool[Tensor, "b n"] | None,
    config: LossConfig,
) -> Loss:
    """Negative log density of the true poses, nats, in the scene's box a twentieth of the density taken as even.

    So an image that nothing else shows, of which there is nothing to learn, cannot outweigh the rest. The distance is
    that of the heaviest component.

    Args:
        network: In training mode.
        feature: Of the images, from `describe`.
        true_translation: Metres, of world_from_camera.
        true_rotation: Rotation matrices of world_from_camera.
        hidden: Which of the n images that it remembers it must not recall; None for none.
        config: Weights of the distance.
    """
    mixture = network.components(feature, hidden)
    truth = true_translation[:, None], true_rotation[:, None]
    even = -float(np.log(network.box.extent.prod() * 8.0 * np.pi**2))
    found = mixture.log_density(*truth)[:, 0] + math.log1p(-_EVEN)
    total = -torch.logaddexp(found, found.new_tensor(even + math.log(_EVEN))).mean()
    row, heaviest = torch.arange(len(feature)), mixture.log_weights.argmax(dim=1)
    poses = mixture.translation[row, heaviest], mixture.rotation[row, heaviest]
    distance = pose_distance(*poses, true_translation, true_rotation, config, network.box).mean().detach()
    return Loss(total, torch.zeros_like(distance), distance)


def flow_loss(
    network: FlowRegressor,
    images: Float[Tensor, "b 3 h w"],
    true_translation: Float[Tensor, "b 3"],
    true_rotation: Float[Tensor, "b 3 3"],
    noise: Float[Tensor, "b 1 6"],
    config: LossConfig,
) -> Loss:
    """Negative log density of the true poses, nats, after noise of the stated size; the distance is of one sample each.

    Args:
        network: In training mode.
        images: Normalised images.
        true_translation: Metres, of world_from_camera.
        true_rotation: Rotation matrices of world_from_camera.
        noise: Standard normal; moves the true poses and gives the sample.
        config: Size of the noise.
    """
    feature = network.describe(images)
    truth = true_translation[:, None], true_rotation[:, None]
    with torch.no_grad():
        distance = pose_distance(*network.sample(feature, noise), *truth, config, network.box).mean()
    with torch.autocast(images.device.type, enabled=False):
        turn = config.target_noise_rad * noise[..., 3:]
        angle = torch.linalg.vector_norm(turn, dim=-1).clamp_min(1e-9)
        translation = truth[0] + config.target_noise_m * noise[..., :3]
        rotation = truth[1] @ rodrigues(turn / angle[..., None], angle)
    total = -network.log_density(feature, translation, rotation).mean()
    return Loss(total, torch.zeros_like(distance), distance)


def _errors(
    poses: tuple[Tensor, Tensor], truth: tuple[Tensor, Tensor], config: LossConfig, box: SceneBox
) -> tuple[Float[Tensor, "*b"], Float[Tensor, "*b"]]:
    """‖t̂ − t‖₂ in the configured unit, and ‖R̂ − R‖_F."""
    apart = poses[0] - truth[0]
    if config.position_unit == "box":
        apart = apart * apart.new_tensor(np.minimum(box.extent.max() / box.extent, _LARGEST_WEIGHT))
    return torch.linalg.vector_norm(apart, dim=-1), torch.linalg.vector_norm(poses[1] - truth[1], dim=(-2, -1))


def _relative(translation: Tensor, rotation: Tensor, half: int, axes: Tensor) -> tuple[Tensor, Tensor]:
    """Poses of the second half as seen from the first; `axes` turns what they see to the world's axes."""
    back = rotation[:half].mT
    shift = (axes @ back @ (translation[half : 2 * half] - translation[:half])[..., None])[..., 0]
    return shift, back @ rotation[half : 2 * half]
