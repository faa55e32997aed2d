"""The variational pose regressor: image -> latent Gaussian -> camera poses (Zangeneh et al., ICRA 2023)."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

from filtering.se3 import Poses
from vapor.regressors.base import Features, Images, Noise, PoseRegressor, PoseSamples, Positions, Rotations
from vapor.regressors.layers import PoseMap, repeated
from vapor.regressors.loss import pose_distance
from vapor.regressors.loss_config import LossConfig
from vapor.regressors.network_config import NetworkConfig
from vapor.regressors.scene_box import SceneBox

LatentSamples = Float[Tensor, "*batch d"]


class VariationalPoseRegressor(PoseRegressor):
    """The paper's network: `encode` an image once, `decode` any number of latent samples."""

    def __init__(self, config: NetworkConfig, box: SceneBox) -> None:
        super().__init__(config, box)
        # Two heads: one head for both would tie the spread of a latent to its place.
        self.latent_mean = nn.Linear(config.feature_dim, config.latent_dim)
        self.latent_log_variance = nn.Linear(config.feature_dim, config.latent_dim)
        layers: list[nn.Module] = [nn.Linear(config.latent_dim, config.hidden_width), nn.ReLU()]
        for _ in range(config.hidden_layers):
            layers += [nn.Linear(config.hidden_width, config.hidden_width), nn.ReLU()]
        shortcut_dim = config.latent_dim if config.shortcut else 0
        self.pose_map = PoseMap(nn.Sequential(*layers), config.hidden_width, box, shortcut_dim)
        self.noise_dim = config.latent_dim

    def encode(self, images: Float[Tensor, "b 3 h w"]) -> tuple[Float[Tensor, "b d"], Float[Tensor, "b d"]]:
        """Mean μ and log variance log σ² of the latent Gaussian of normalised images."""
        return self.latent(self.extract_features(images))

    def latent(self, feature: Float[Tensor, "b f"]) -> tuple[Float[Tensor, "b d"], Float[Tensor, "b d"]]:
        """Mean μ and log variance log σ² of the latent Gaussian of images with these features."""
        with torch.autocast(feature.device.type, enabled=False):
            return self.latent_mean(feature), self.latent_log_variance(feature).clamp(-20.0, 20.0)

    def decode(self, latent: LatentSamples) -> tuple[Float[Tensor, "*batch 3"], Float[Tensor, "*batch 3 3"]]:
        """Translations in metres and rotation matrices, world_from_camera, of latent samples."""
        with torch.autocast(latent.device.type, enabled=False):
            return self.pose_map(latent)

    def sample(self, feature: Features, noise: Noise) -> PoseSamples:
        """The pose map of z = μ + σ ⊙ ε, for given ε."""
        return self.decode(sample_latent(*self.latent(feature), noise))

    def loss(
        self, images: Images, true_translation: Positions, true_rotation: Rotations, noise: Noise, config: LossConfig
    ) -> Float[Tensor, ""]:
        """β KL + mean d_pose over the batch and, for each image, the ⌊αM⌋ samples nearest to its true pose.

        All M samples are mapped without gradient to find the winners; only the winners are mapped again with gradient.
        The gradient is the same as of mapping all with gradient.
        """
        mean, log_variance = self.encode(images)
        truth = true_translation[:, None], true_rotation[:, None]
        with torch.no_grad():
            distance = pose_distance(*self.decode(sample_latent(mean, log_variance, noise)), *truth, config, self.box)
            winners = distance.topk(config.num_winners, dim=1, largest=False, sorted=False).indices
            winning_noise = noise.gather(1, winners[..., None].expand(-1, -1, noise.shape[-1]))
        latent = sample_latent(mean, log_variance, winning_noise)
        nearest = pose_distance(*self.decode(latent), *truth, config, self.box).mean()
        return config.beta * kl_divergence(mean, log_variance).mean() + nearest

    def samples_in_training(self, scheduled: int) -> int:
        """The number of the schedule: the winners are found among these samples."""
        return scheduled

    @torch.no_grad()
    def initialise(self, training_poses: Poses, *, log_variance: float) -> None:
        """Give the latent about this log variance before training."""
        self.latent_log_variance.bias.add_(log_variance)


def sample_latent(
    mean: Float[Tensor, "b d"], log_variance: Float[Tensor, "b d"], noise: Float[Tensor, "b m d"]
) -> Float[Tensor, "b m d"]:
    """z = μ + σ ⊙ ε."""
    return mean[:, None] + torch.exp(0.5 * log_variance)[:, None] * noise


def kl_divergence(mean: Float[Tensor, "b d"], log_variance: Float[Tensor, "b d"]) -> Float[Tensor, " b"]:
    """KL(N(μ, diag σ²) ‖ N(0, I)) in nats: ½ Σ (μ² + σ² − 1 − log σ²)."""
    return 0.5 * (mean.square() + log_variance.exp() - 1.0 - log_variance).sum(dim=-1)


class DeterministicPoseRegressor(VariationalPoseRegressor):
    """The same layers, without use of the latent variance; all samples of an image are one pose."""

    def __init__(self, config: NetworkConfig, box: SceneBox) -> None:
        super().__init__(config, box)
        self.noise_dim = 0

    def sample(self, feature: Features, noise: Noise) -> PoseSamples:
        """The pose map of z = μ, m times."""
        mean, _ = self.latent(feature)
        return repeated(self.decode(mean), noise.shape[1])

    def loss(
        self, images: Images, true_translation: Positions, true_rotation: Rotations, noise: Noise, config: LossConfig
    ) -> Float[Tensor, ""]:
        """Mean d_pose over the batch."""
        mean, _ = self.encode(images)
        return pose_distance(*self.decode(mean), true_translation, true_rotation, config, self.box).mean()

    def samples_in_training(self, scheduled: int) -> int:
        """One, as there are no others."""
        return 1
