"""Regressors that recall training images: what they keep of them, and what training asks of such a regressor.

Their backbone never learns. So training extracts the features of every image once, and what learns are maps of these.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, fields

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from vapor.regressors.base import PoseRegressor
from vapor.regressors.loss import Loss, LossConfig


@dataclass(frozen=True)
class Memory:
    """What is kept of n training images.

    Attributes:
        keys: What each looks like, as unit vectors.
        views: What of each tells relative poses.
        translation: Its true position, metres.
        rotation: Its true rotation, world_from_camera.
    """

    keys: Float[Tensor, "n k"]
    views: Float[Tensor, "n v"]
    translation: Float[Tensor, "n 3"]
    rotation: Float[Tensor, "n 3 3"]

    def tensors(self) -> dict[str, Tensor]:
        """All of it, by name."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def cpu(self) -> Memory:
        """The same on the CPU."""
        return Memory(**{name: value.cpu() for name, value in self.tensors().items()})


class RecallingRegressor(PoseRegressor):
    """A regressor with a frozen backbone and a memory of training images.

    Attributes:
        centre: Mean of the backbone's numbers over training images; subclasses register it as a buffer of zeros.
        spread: Their standard deviation; a buffer of ones before there are any.
    """

    frozen_backbone = True
    centre: Tensor
    spread: Tensor

    @property
    def recalling(self) -> RecallingRegressor:
        """This regressor."""
        return self

    def train(self, mode: bool = True) -> RecallingRegressor:
        """Training mode of all but the backbone, whose statistics stay as they are."""
        super().train(mode)
        self.backbone.eval()
        return self

    @property
    def standardised(self) -> bool:
        """Whether `standardise` was called."""
        return bool((self.spread != 1.0).any())

    @torch.no_grad()
    def standardise(self, features: Float[Tensor, "n f"]) -> None:
        """Let `extract_features` give 0 where training images have their mean, in units of their standard deviation.

        Args:
            features: Those of training images so far.
        """
        spread, centre = torch.std_mean(features, dim=0)
        self.centre.copy_(centre)
        self.spread.copy_(spread.clamp_min(1e-3))

    @torch.no_grad()
    def standardise_like(self, other: RecallingRegressor) -> None:
        """Take mean and standard deviation from another regressor of the same shape."""
        self.centre.copy_(other.centre)
        self.spread.copy_(other.spread)

    @abstractmethod
    def remember(
        self, features: Float[Tensor, "n f"], translation: Float[Tensor, "n 3"], rotation: Float[Tensor, "n 3 3"]
    ) -> None:
        """Replace the memory by n images.

        Args:
            features: From `extract_features`, in any precision.
            translation: Their true positions, metres.
            rotation: Their true rotations, world_from_camera.
        """

    @abstractmethod
    def memory_shapes(self) -> dict[str, tuple[int, ...]]:
        """Of one image, the shapes of what is remembered of it, by name."""

    @abstractmethod
    def loss_of_features(
        self,
        feature: Float[Tensor, "b f"],
        true_translation: Float[Tensor, "b 3"],
        true_rotation: Float[Tensor, "b 3 3"],
        hidden: Bool[Tensor, "b n"] | None,
        config: LossConfig,
    ) -> Loss:
        """The loss of one batch, in training mode.

        Args:
            feature: Of the images, from `extract_features`.
            true_translation: Metres, of world_from_camera.
            true_rotation: Rotation matrices of world_from_camera.
            hidden: Which of the n images in memory must not be recalled for each; None for none.
            config: Weights of the loss.
        """

    def loss(
        self,
        images: Float[Tensor, "b 3 h w"],
        true_translation: Float[Tensor, "b 3"],
        true_rotation: Float[Tensor, "b 3 3"],
        noise: Float[Tensor, "b m d"],
        config: LossConfig,
    ) -> Loss:
        """The loss of images of which none is in memory."""
        return self.loss_of_features(self.extract_features(images), true_translation, true_rotation, None, config)

    def _apply(self, fn: Callable[[Tensor], Tensor], recurse: bool = True) -> RecallingRegressor:
        """Take the memory along to another device."""
        super()._apply(fn, recurse)
        if self.memory is not None:
            self.memory = Memory(**{name: fn(value) for name, value in self.memory.tensors().items()})
        return self
