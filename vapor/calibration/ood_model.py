"""The OOD model of a network, learned from its training images."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float32, Int64

from vapor.evaluation.seen_images import describe_images
from vapor.regressors.base import PoseRegressor
from vapor.regressors.ood_model import CHROMA, LEAST_IMAGES, QUANTILE, OodModel
from vapor.training_data.training_set import TrainingSet

EXEMPLARS = 1000
"""Training images that an image is compared with, at most."""
_AXES = 48
_FLATTEN = 0.3  # an axis with k times less variance than the first is stretched by k^(0.3 / 2)
_FEW_SEQUENCES, _BLOCKS = 8, 10
_CHROMA_WEIGHT = 0.5


def learn_ood_model(network: PoseRegressor, training: TrainingSet, held_out: TrainingSet) -> OodModel | None:
    """The OOD model of at most `EXEMPLARS` training images in order of time; None with fewer than 50.

    The threshold follows from held-out images of the place, if there are 50.
    """
    if len(training) < LEAST_IMAGES:
        return None
    segment = training.sequence
    if len(np.unique(segment)) < _FEW_SEQUENCES:
        segment = np.arange(len(training)) * _BLOCKS // len(training)
    ood_model = fit_ood_model(describe_images(network, training), segment)
    return ood_model.with_threshold_of(describe_images(network, held_out))


def fit_ood_model(features: Float32[np.ndarray, "n d"], segment: Int64[np.ndarray, " n"]) -> OodModel:
    """The OOD model from features of n training images, each from one of several segments of the data."""
    centre, spread = features.mean(axis=0), features.std(axis=0)
    spread = np.maximum(spread, 1e-3 * spread.mean() + 1e-6)
    backbone, chroma = features.shape[1] - CHROMA, CHROMA
    weight = np.repeat([1.0 / np.sqrt(backbone), _CHROMA_WEIGHT / np.sqrt(chroma)], [backbone, chroma])
    scale = (spread / weight).astype(np.float32)
    standard = ((features - centre) / scale).astype(np.float64)
    variance, axes = np.linalg.eigh(standard.T @ standard / len(standard))
    count = min(_AXES, len(variance), len(features) - 1)
    variance, axes = np.maximum(variance[::-1][:count], 1e-6 * variance[-1] + 1e-12), axes[:, ::-1][:, :count]
    axes = _as_stored(axes)
    stretch = ((variance / variance[0]) ** (-_FLATTEN / 2)).astype(np.float32)
    exemplars = _as_stored(((features - centre) / scale) @ axes * stretch)
    fitted = OodModel(centre, scale, axes, stretch, exemplars, 1.0, 1.0)
    own = np.empty(len(features))
    for number in np.unique(segment):
        of_others = replace(fitted, exemplars=exemplars[segment != number])
        own[segment == number] = of_others.ood_score(features[segment == number])
    distance = max(float(np.quantile(own, QUANTILE)), 1e-6)
    return replace(fitted, own_distance=distance, threshold=distance)


def _as_stored(values: np.ndarray) -> Float32[np.ndarray, "a b"]:
    return values.astype(np.float16).astype(np.float32)
