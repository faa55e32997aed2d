"""A regressor with a memory: similar training images, and the camera's motion from each.

The posterior is a mixture with one component for each of the most similar training images: its weight is the
similarity, its mean the pose of the training image moved by the estimated motion between the two. So every similar
place is represented, and learning is about pairs of images, of which there are many more than images.

Sources: Arandjelović et al., "NetVLAD", CVPR 2016 (places by appearance); Wu et al., "Improving generalization
via scalable neighborhood component analysis", ECCV 2018 (learned against a memory of all images); Balntas et al.,
"RelocNet", ECCV 2018, and Laskar et al., "Camera relocalization by computing pairwise relative poses", ICCVW 2017 (the
pose of the image found, moved by a learned relative pose).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn import functional

from vapor.regressors.base import Features, Images, Noise, Positions, Rotations
from vapor.regressors.layers import mean_of_cells, rodrigues
from vapor.regressors.loss_config import LossConfig
from vapor.regressors.mixture import Components, MixtureDensity
from vapor.regressors.network_config import NetworkConfig, stage_channels
from vapor.regressors.scene_box import SceneBox

_GRID = 3, 4  # rows and columns in which the third stage is kept: where in the image things are
_KEY_DIM = 128
_SCALE = 15.0  # of the cosine between two keys, at first
_UNIT = 0.02  # of the geometric mean of the scene box's edges: a small distance
_TURN_RAD = 0.1  # a small turn
_REACH = 2.0, 3.0  # offsets of one unit of the network's output, in small distances and turns
_NARROWEST, _WIDEST = 0.05, 20.0  # component, in small distances and turns
_WIDEST_RAD = 1.0
_EVEN = 0.05  # fraction of the density that the loss spreads over the scene
_HIDDEN = -1e4  # similarity of images that must not be recalled


@dataclass(frozen=True)
class Memory:
    """Training images in memory: unit vectors `keys` for similarity, `views` for relative poses, and true poses."""

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


class RetrievalRegressor(MixtureDensity):
    """A mixture whose components are similar training images, moved by learned relative poses.

    The backbone, mostly ImageNet's, never changes: an image is represented by means of the last layer, and by means of
    the third stage in twelve cells. Only maps of these numbers are learned. Of the configuration, `components` is the
    number of recalled images, `hidden_width` the size of the map from pairs of images to relative poses, `feature_dim`
    the size of the map to keys. The size of the box is the unit of lengths.

    Attributes:
        centre: Mean of the backbone's numbers over training images.
        spread: Their standard deviation; ones before `standardise`.
    """

    frozen_backbone = True
    centre: Tensor
    spread: Tensor

    def __init__(self, config: NetworkConfig, box: SceneBox) -> None:
        super().__init__(config, box)
        size = self.backbone.num_features + _GRID[0] * _GRID[1] * stage_channels(config.backbone)[2]
        width = config.hidden_width
        self.backbone.requires_grad_(False).eval()
        self.feature = nn.Linear(size, config.feature_dim)
        self.key = nn.Linear(config.feature_dim, _KEY_DIM)
        self.own_view, self.view = nn.Linear(size, width), nn.Linear(size, width, bias=False)
        last = nn.Linear(width, 9)
        self.relative = nn.Sequential(nn.ReLU(), nn.Linear(width, width), nn.ReLU(), last)
        self.log_scale = nn.Parameter(torch.tensor(_SCALE).log())
        with torch.no_grad():
            last.weight.mul_(0.1)
            last.bias.zero_()
        self.register_buffer("centre", torch.zeros(size))
        self.register_buffer("spread", torch.ones(size))
        self.unit_m = _UNIT * float(box.extent.prod()) ** (1 / 3)

    @property
    def recalling(self) -> RetrievalRegressor:
        """This regressor."""
        return self

    def train(self, mode: bool = True) -> RetrievalRegressor:
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
        """Let `extract_features` give 0 for the mean of these features, in units of their standard deviation."""
        spread, centre = torch.std_mean(features, dim=0)
        self.centre.copy_(centre)
        self.spread.copy_(spread.clamp_min(1e-3))

    @torch.no_grad()
    def standardise_like(self, other: RetrievalRegressor) -> None:
        """Take mean and standard deviation from another regressor of the same shape."""
        self.centre.copy_(other.centre)
        self.spread.copy_(other.spread)

    def extract_features(self, images: Images) -> Features:
        """The backbone's numbers of normalised images, each in units of its spread over the training images."""
        return self.standardised_numbers(self.numbers(images))

    @torch.no_grad()
    def numbers(self, images: Images) -> Float[Tensor, "b f"]:
        """The backbone's numbers of normalised images, as they are."""
        third, last = self.backbone.maps(images)
        cells = mean_of_cells(third, _GRID).flatten(1)
        return torch.cat([last.mean(dim=(2, 3)), cells], dim=1).to(self.centre.dtype)

    @torch.no_grad()
    def standardised_numbers(self, numbers: Float[Tensor, "b f"]) -> Features:
        """The backbone's numbers in units of their spread over the training images."""
        return (numbers - self.centre) / self.spread

    @torch.no_grad()
    def remember(
        self, features: Float[Tensor, "n f"], translation: Float[Tensor, "n 3"], rotation: Float[Tensor, "n 3 3"]
    ) -> None:
        """Replace the memory by n images with these features, of any precision, and true poses, world_from_camera."""
        parts = [(self._keys(part), self.view(part)) for part in map(Tensor.float, features.split(4096))]
        keys, views = (torch.cat(list(each)) for each in zip(*parts, strict=True))
        self.memory = Memory(keys, views, translation, rotation)

    def components(self, feature: Float[Tensor, "b f"], hidden: Bool[Tensor, "b n"] | None = None) -> Components:
        """The mixtures of images with these features, without the remembered images that are `hidden`."""
        memory = self._remembered()
        with torch.autocast(feature.device.type, enabled=False):
            likeness = self.log_scale.exp() * self._keys(feature) @ memory.keys.T
            if hidden is not None:
                likeness = likeness.masked_fill(hidden, _HIDDEN)
            likeness, which = likeness.topk(min(self.config.components, likeness.shape[1]), dim=1)
            output = self.relative(self.own_view(feature)[:, None] + memory.views[which])
            move, turn, widths, more = output.split((3, 3, 2, 1), dim=-1)
            rotation = memory.rotation[which]
            move = _REACH[0] * self.unit_m * move
            translation = memory.translation[which] + (rotation @ move[..., None])[..., 0]
            angle = torch.linalg.vector_norm(_REACH[1] * _TURN_RAD * turn, dim=-1).clamp_min(1e-9)
            rotation = rotation @ rodrigues(_REACH[1] * _TURN_RAD * turn / angle[..., None], angle)
            widths = torch.exp(widths.clamp(-20.0, 20.0)).clamp(_NARROWEST, _WIDEST)
            # No tensor of the units: it would be copied to a GPU, which may not happen while kernels are recorded.
            metres, radians = self.unit_m * widths[..., 0], (_TURN_RAD * widths[..., 1]).clamp_max(_WIDEST_RAD)
            widths = torch.stack([metres, radians], dim=-1)
            return Components(torch.log_softmax(likeness + more[..., 0], dim=1), translation, rotation, widths)

    def loss_of_features(
        self,
        feature: Features,
        true_translation: Positions,
        true_rotation: Rotations,
        hidden: Bool[Tensor, "b n"] | None,
    ) -> Float[Tensor, ""]:
        """Negative log density of the true poses, nats, without recalling the images in memory that are `hidden`.

        A twentieth of the density is even over the scene's box, so that images of ground that no other image shows
        cannot outweigh the rest.
        """
        mixture = self.components(feature, hidden)
        even = -float(np.log(self.box.extent.prod() * 8.0 * np.pi**2))
        found = mixture.log_density(true_translation[:, None], true_rotation[:, None])[:, 0] + math.log1p(-_EVEN)
        return -torch.logaddexp(found, found.new_tensor(even + math.log(_EVEN))).mean()

    def memory_shapes(self) -> dict[str, tuple[int, ...]]:
        """Shapes of the memory of one image, by name."""
        return {"keys": (_KEY_DIM,), "views": (self.config.hidden_width,), "translation": (3,), "rotation": (3, 3)}

    def loss(
        self, images: Images, true_translation: Positions, true_rotation: Rotations, noise: Noise, config: LossConfig
    ) -> Float[Tensor, ""]:
        """The loss of images that are not in memory."""
        return self.loss_of_features(self.extract_features(images), true_translation, true_rotation, None)

    def _apply(self, fn: Callable[[Tensor], Tensor], recurse: bool = True) -> RetrievalRegressor:
        """Take the memory along to another device."""
        super()._apply(fn, recurse)
        if self.memory is not None:
            self.memory = Memory(**{name: fn(value) for name, value in self.memory.tensors().items()})
        return self

    def _keys(self, feature: Float[Tensor, "b f"]) -> Float[Tensor, "b k"]:
        return functional.normalize(self.key(torch.relu(self.feature(feature))), dim=-1)

    def _remembered(self) -> Memory:
        if self.memory is None:
            raise RuntimeError("nothing is remembered yet, expected `remember` before poses are asked for")
        return self.memory
