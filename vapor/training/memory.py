"""Training data of a regressor that recalls images: features, extracted once, and images that it must not recall."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import torch
from jaxtyping import Bool, Float, Float64, Int64, UInt8
from torch import Tensor

from vapor.evaluation.seen_images import features_of
from vapor.regressors.base import PoseRegressor
from vapor.regressors.retrieval import RetrievalRegressor
from vapor.training.augment import Variation, draw_variation, jitter_and_normalise, one_ahead, random_crops
from vapor.training.config import TrainConfig
from vapor.training.holding_out import way_of
from vapor.training.processes import own_part, sum_of_all
from vapor.training_data.ground import near_scale_m
from vapor.training_data.training_set import TrainingSet

_ALONE = 0.2  # length of the own pass that is hidden where nothing else shows a place, in units of `way_of`
_CHUNK = 512
VARIANTS = 6
"""Greatest number of variations of each training image."""
_VARIANTS_BYTES = 10**9
_BATCH, _BACKBONE_BATCH = 64, 32  # varied, and seen by the backbone, at a time


@dataclass(frozen=True)
class TrainingFeatures:
    """Features of n training images by a backbone that does not learn, half precision, on the network's device.

    Attributes:
        images: The images.
        features: Their features, from `extract_features`.
        translation: True positions, metres.
        rotation: True rotations, world_from_camera.
        walk: Number of the walk of each image.
        way: Distance that the camera has covered, from `way_of`.
        reach: Distance within which images of the same recording are hidden from each image.
        variants: Features of the images after augmentation, by the number of the variation.
    """

    images: TrainingSet
    features: Float[Tensor, "n f"]
    translation: Float[Tensor, "n 3"]
    rotation: Float[Tensor, "n 3 3"]
    walk: Int64[Tensor, " n"]
    way: Float[Tensor, " n"]
    reach: Float[Tensor, " n"]
    variants: dict[int, Float[Tensor, "n f"]] = field(default_factory=dict)

    @property
    def num_variants(self) -> int:
        """Number of variations of each image."""
        return int(np.clip(_VARIANTS_BYTES // (self.features.nbytes + 1), 1, VARIANTS))

    def varied(
        self, network: RetrievalRegressor, number: int, config: TrainConfig, *, bfloat16: bool
    ) -> Float[Tensor, "n f"]:
        """Features of the images after the variation of this number, modulo `num_variants`; half precision."""
        variant = number % self.num_variants
        if variant not in self.variants:
            size, device = (config.network.image_width, config.network.image_height), self.features.device
            rng, features = np.random.default_rng([config.seed, variant]), torch.zeros_like(self.features)
            whole, rows = self.images.images, self.images.rows
            spare = whole.shape[1] - size[1], whole.shape[2] - size[0]

            def vary(begin: int) -> tuple[Int64[np.ndarray, " k"], Variation, UInt8[np.ndarray, "k h w 3"]]:
                count = min(_BATCH, len(rows) - begin)
                own = own_part(count)
                variation = draw_variation(config.augment, count, spare, rng=rng)[own]
                return begin + own, variation, random_crops(whole, rows[begin + own], variation, size)

            for part, variation, crops in one_ahead(vary, range(0, len(rows), _BATCH)):
                if not len(part):  # fewer images than processes
                    continue
                pixels = torch.from_numpy(crops).to(device)
                images = jitter_and_normalise(pixels, network.pixel_mean, network.pixel_std, variation)
                with torch.autocast(device.type, torch.bfloat16, enabled=bfloat16):
                    found = [network.extract_features(some) for some in images.split(_BACKBONE_BATCH)]
                features[part] = torch.cat(found).to(features.dtype)
            self.variants[variant] = sum_of_all(features)
        return self.variants[variant]

    def hidden(self, indices: Int64[np.ndarray, " b"]) -> Bool[Tensor, "b n"]:
        """The images that each of these must not recall: its own pass, which no image in use will be part of."""
        rows = torch.from_numpy(indices).to(self.way.device)
        near = (self.way[rows][:, None] - self.way).abs() < self.reach[rows][:, None]
        return near & (self.walk[rows][:, None] == self.walk)


def extract_training_features(
    network: RetrievalRegressor, images: TrainingSet, known: TrainingFeatures | None = None
) -> TrainingFeatures:
    """Features of training images, in order of time.

    A network that is not standardised yet is standardised by these images. `known` features are not extracted again.
    """
    device = network.pixel_mean.device
    features = torch.empty(len(images), len(network.centre), dtype=torch.float16, device=device)
    new = np.ones(len(images), bool)
    if known is not None and known.images.images is images.images:
        at = np.searchsorted(known.images.rows, images.rows).clip(max=len(known.images) - 1)
        new = known.images.rows[at] != images.rows
        features[~new] = known.features[at[~new]]
    asked = np.flatnonzero(new)
    own, found = own_part(len(asked)), torch.zeros(len(asked), len(network.centre), device=device)
    found[own] = features_of(network, images.select(asked[own]))
    found = sum_of_all(found)
    if not network.standardised:
        network.standardise(found)
        found = (found - network.centre) / network.spread
    features[new] = found.half()
    way = way_of(images)
    return TrainingFeatures(
        images,
        features,
        torch.from_numpy(images.poses.translation).float().to(device),
        torch.from_numpy(images.poses.rotation).float().to(device),
        torch.from_numpy(images.walk).to(device),
        torch.from_numpy(way).float().to(device),
        torch.from_numpy(np.where(_shown_again(images, way), 1.0, _ALONE)).float().to(device),
    )


def remember(network: PoseRegressor, features: TrainingFeatures | None) -> None:
    """Let a network that recalls images remember these with its present weights; others are left as they are."""
    if network.recalling is not None and features is not None:
        network.recalling.remember(features.features, features.translation, features.rotation)


def _shown_again(images: TrainingSet, way: Float64[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Whether another pass or recording shows the ground of each image."""
    walk = images.walk
    at = (images.poses.translation / near_scale_m(images.poses)).astype(np.float32)
    ahead = images.poses.rotation[:, :, 2].astype(np.float32)
    square, shown = (at**2).sum(axis=1), np.zeros(len(images), bool)
    for begin in range(0, len(images), _CHUNK):
        own = slice(begin, begin + _CHUNK)
        near = square[own, None] + square - 2.0 * at[own] @ at.T < 1.0
        near &= ahead[own] @ ahead.T > np.cos(np.pi / 4)
        apart = np.abs(way[own, None] - way) >= 1.0
        shown[own] = (near & (apart | (walk[own, None] != walk))).any(axis=1)
    return shown
