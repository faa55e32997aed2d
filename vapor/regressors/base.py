"""The interface of pose regressors: an image in, samples of the posterior over camera poses out; and their training.

A new regressor is a file with a subclass of `PoseRegressor`, and its row in `vapor.regressors.network_config`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, ClassVar

import torch
from jaxtyping import Float, UInt8
from torch import Tensor, nn

from filtering.se3 import Poses
from vapor.regressors.loss_config import LossConfig
from vapor.regressors.network_config import NetworkConfig, make_backbone, pixel_statistics
from vapor.regressors.scene_box import SceneBox

if TYPE_CHECKING:
    from vapor.regressors.retrieval import Memory, RetrievalRegressor

Images = Float[Tensor, "b 3 h w"]
"""Images as `PoseRegressor.normalise` gives them."""
Features = Float[Tensor, "b f"]
"""Features of images, as `PoseRegressor.extract_features` gives them."""
Noise = Float[Tensor, "b m d"]
"""Standard normal numbers, d for each of m posterior samples of an image."""
Positions = Float[Tensor, "b 3"]
"""True positions, metres, world_from_camera."""
Rotations = Float[Tensor, "b 3 3"]
"""True rotation matrices, world_from_camera."""
PoseSamples = tuple[Float[Tensor, "b m 3"], Float[Tensor, "b m 3 3"]]
"""Positions in metres and rotation matrices of m posterior samples of each image, world_from_camera."""


class PoseRegressor(nn.Module, ABC):
    """Image -> samples of the posterior over camera poses.

    Subclasses define `sample` and `loss`; the other methods may be replaced.

    Attributes:
        noise_dim: Number of standard normal numbers that one sample is made from.
        memory: The training images that it recalls; None before training, and of a regressor that recalls no images.
        learns_relative_poses: Whether its loss compares pairs of images with `LossConfig.relative`.
        frozen_backbone: Whether the backbone never learns.
    """

    noise_dim: int
    learns_relative_poses: ClassVar[bool] = False
    frozen_backbone: ClassVar[bool] = False
    pixel_mean: Tensor
    pixel_std: Tensor

    def __init__(self, config: NetworkConfig, box: SceneBox) -> None:
        super().__init__()
        self.config, self.box = config, box
        self.memory: Memory | None = None
        self.backbone = make_backbone(config.backbone)
        self.feature = nn.Linear(self.backbone.num_features, config.feature_dim)
        mean, std = pixel_statistics(config.backbone)
        self.register_buffer("pixel_mean", torch.tensor(mean), persistent=False)
        self.register_buffer("pixel_std", torch.tensor(std), persistent=False)

    @property
    def recalling(self) -> RetrievalRegressor | None:
        """This regressor where it recalls training images, else None."""
        return None

    # --- from images to poses ----------------------------------------------------------------------

    def normalise(self, images: UInt8[Tensor, "b h w 3"]) -> Images:
        """Images of pixels 0..255, by the backbone's mean and standard deviation; channels-last in memory."""
        return ((images.float() - self.pixel_mean) / self.pixel_std).permute(0, 3, 1, 2)

    def extract_features(self, images: Images) -> Features:
        """Features of normalised images, in the precision of the weights: bfloat16 has steps of 3 cm in 10 m."""
        return torch.relu(self.feature(self.backbone(images))).to(self.feature.weight.dtype)

    @abstractmethod
    def sample(self, feature: Features, noise: Noise) -> PoseSamples:
        """Posterior samples of images with these features, for given noise."""

    def forward(self, images: Images, noise: Noise) -> PoseSamples:
        """Posterior samples of normalised images for given noise."""
        return self.sample(self.extract_features(images), noise)

    # --- training ----------------------------------------------------------------------------------

    @abstractmethod
    def loss(
        self, images: Images, true_translation: Positions, true_rotation: Rotations, noise: Noise, config: LossConfig
    ) -> Float[Tensor, ""]:
        """The loss of one batch, in training mode, with noise of `samples_in_training` samples of each image.

        With `relative`, the two halves of the batch are pairs.
        """

    def samples_in_training(self, scheduled: int) -> int:
        """Number of posterior samples of an image that the loss takes, given the number of the schedule."""
        return 1

    def initialise(self, training_poses: Poses, *, log_variance: float) -> None:
        """Adapt the random weights to training poses (n,) and to the configured log σ² of a latent."""


class DensityRegressor(PoseRegressor):
    """A regressor whose posterior density can be evaluated, without kernels over its samples."""

    @abstractmethod
    def log_density(
        self, feature: Features, translation: Float[Tensor, "b n 3"], rotation: Float[Tensor, "b n 3 3"]
    ) -> Float[Tensor, "b n"]:
        """Log density of the samples' distribution at n poses for each image, per m³ rad³; −∞ where it is 0.

        Translations in metres and rotation matrices, world_from_camera; the volume of all rotations is 8π².
        """
