"""Metrics of the posteriors of held-out images, by which training selects weights."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float64
from torch import Tensor

from filtering.se3 import Poses
from vapor.checkpoints.calibration import Calibration
from vapor.evaluation.seen_images import crops_of, features_of
from vapor.evaluation.trajectory import is_right
from vapor.regressors.base import DensityRegressor, PoseRegressor
from vapor.training_data.training_set import TrainingSet

_BATCH = 64
_MAX_NOISE = 2**25  # numbers at a time: dropout takes 2048 for every sample
LOG_FLOOR = float(np.log(1e-4))
"""Log density per m³ rad³ that is added at a true pose, so that no single image decides."""


@dataclass(frozen=True)
class Validation:
    """Figures of one epoch on held-out images, means over the images; epochs count from 1.

    The recalls are fractions within 0.3 m and 20° of the true pose: of the posterior samples, and of the images by
    their sample of highest density. The log density is the mean of log(p̂(true pose) + 10⁻⁴ per m³ rad³): unlike the
    recalls it falls when a possible place is forgotten, which no filter can repair.
    """

    epoch: int
    train_loss: float
    sample_recall: float
    mode_recall: float
    log_density: float


def validate(
    network: PoseRegressor,
    held_out: TrainingSet,
    calibration: Calibration,
    *,
    num_samples: int,
    seed: int,
    epoch: int,
    train_loss: float,
) -> Validation:
    """Evaluate the posteriors of the centre crops of held-out images, scaled as for training.

    The latent noise is that of the seed, the same every time; the network may be in any mode, and is left as it was.
    `epoch` and `train_loss` are passed through.
    """
    figures = []
    for i, samples in enumerate(predict(network, held_out, num_samples, seed)):
        truth = held_out.poses[[i]]
        density = calibration.density(samples)
        log_density = density.log_density(Poses.concatenate([samples, truth]))
        near = is_right(samples, truth)
        figures.append((near.mean(), near[log_density[:-1].argmax()], np.logaddexp(log_density[-1], LOG_FLOOR)))
    sample_recall, mode_recall, log_density = np.array(figures, np.float64).mean(axis=0)
    return Validation(epoch, train_loss, float(sample_recall), float(mode_recall), float(log_density))


def predict(network: PoseRegressor, images: TrainingSet, num_samples: int, seed: int) -> Iterator[Poses]:
    """Posterior samples (num_samples,) of each image's centre crop, float32 arithmetic, with latent noise of the seed.

    Images are scaled as for training.
    """
    device = network.pixel_mean.device
    generator = torch.Generator(device).manual_seed(seed)
    batch = max(1, min(_BATCH, _MAX_NOISE // (num_samples * max(1, network.noise_dim))))
    recalling = network.recalling
    draw = network if recalling is None else recalling.sample
    given = (
        (crops for _, crops in batches(network, images, batch))
        if recalling is None
        else features_of(recalling, images).split(batch)
    )
    for part in given:
        with torch.inference_mode():
            noise = torch.randn(len(part), num_samples, network.noise_dim, generator=generator, device=device)
            drawn = draw(part, noise)
            translation, rotation = (p.cpu().double().numpy() for p in drawn)
        for i in range(len(part)):
            yield Poses(rotation[i], translation[i])


def exact_log_density(network: PoseRegressor, images: TrainingSet) -> Float64[np.ndarray, " n"] | None:
    """Log density per m³ rad³ of each image's posterior at its true pose, (n,); None without a closed form."""
    if not isinstance(network, DensityRegressor):
        return None
    found = np.empty(len(images))
    for rows, crops in batches(network, images):
        truth = (getattr(images.poses[rows], part) for part in ("translation", "rotation"))
        with torch.inference_mode():
            poses = (torch.from_numpy(part)[:, None].to(crops) for part in truth)
            found[rows] = network.log_density(network.extract_features(crops), *poses)[:, 0].cpu().double().numpy()
    return found


def batches(network: PoseRegressor, images: TrainingSet, size: int = _BATCH) -> Iterator[tuple[slice, Tensor]]:
    """Slices of the images and their normalised centre crops; the network is in evaluation mode meanwhile."""
    training = network.training
    network.eval()
    for part, pixels in crops_of(network, images.images, images.rows, size):
        yield part, network.normalise(pixels)
    network.train(training)
