"""The training loss: KL divergence of the latent, and winners take all over the posterior samples."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from filtering.errors import require_within
from vapor.network import VariationalPoseRegressor, sample_latent


@dataclass(frozen=True)
class LossConfig:
    """Weights of the loss; the defaults are the paper's, λ for its ambiguous scenes."""

    lambda_translation: float = 5.0
    """λ_t, per metre."""
    lambda_rotation: float = 2.0
    """λ_r, per unit of ‖R̂ − R‖_F."""
    alpha: float = 0.2
    """Share of the samples, the nearest to the true pose, that learn from it."""
    beta: float = 0.01
    """Weight of the KL divergence."""
    num_samples: int = 256
    """M, posterior samples per image; the paper draws 1000."""

    def __post_init__(self) -> None:
        require_within(
            self,
            lambda_translation=(0.0, 1e9),
            lambda_rotation=(0.0, 1e9),
            alpha=(1e-6, 1.0),
            beta=(0.0, 1e9),
            num_samples=(1, 10**6),
        )

    @property
    def num_winners(self) -> int:
        """⌊αM⌋, at least 1."""
        return max(1, int(self.alpha * self.num_samples + 1e-9))


@dataclass(frozen=True)
class Loss:
    """The loss of one batch and its two parts, scalars.

    Attributes:
        total: β KL + winners' mean distance; carries the gradient.
        kl: Mean KL divergence over the batch, nats.
        distance: Mean d_pose of the winners.
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
) -> Float[Tensor, "*batch"]:
    """d_pose = λ_t ‖t̂ − t‖₂ + λ_r ‖R̂ − R‖_F; true poses broadcast."""
    metres = torch.linalg.vector_norm(translation - true_translation, dim=-1)
    chord = torch.linalg.vector_norm(rotation - true_rotation, dim=(-2, -1))
    return config.lambda_translation * metres + config.lambda_rotation * chord


def regression_loss(
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
        distance = pose_distance(*network.decode(sample_latent(mean, log_variance, noise)), *truth, config)
        winners = distance.topk(config.num_winners, dim=1, largest=False, sorted=False).indices
        winning_noise = noise.gather(1, winners[..., None].expand(-1, -1, noise.shape[-1]))
    latent = sample_latent(mean, log_variance, winning_noise)
    nearest = pose_distance(*network.decode(latent), *truth, config).mean()
    kl = kl_divergence(mean, log_variance).mean()
    return Loss(config.beta * kl + nearest, kl.detach(), nearest.detach())
