"""Weights of the places of held-out images: what their ratios are worth, and whether they are probabilities."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float64, Int64

from filtering.measurement_noise import MeasurementNoise
from filtering.posterior import PosePosterior
from filtering.training_prior import TrainingPrior
from vapor.calibration.places import Observations
from vapor.evaluation.reliability import Reliability

_POWERS = np.arange(41) / 40
_NOT_EXCLUDED = 1.35  # nats below the highest likelihood: a one-sided 95 % interval of one parameter


@dataclass(frozen=True)
class PlaceWeights:
    """All p places of n held-out images, by image, with their weights and where the true pose is.

    Attributes:
        posteriors: Of each image, (n,).
        image: Number of the image of each place, in increasing order, (p,).
        relative: Weight of each place over that of the image's heaviest one, (p,).
        right: Whether the true pose is within the radius of a place, so that it is the true place, (p,).
        squared: Squared Mahalanobis distance of the true pose from each place, (p,).
    """

    posteriors: tuple[PosePosterior, ...]
    image: Int64[np.ndarray, " p"]
    relative: Float64[np.ndarray, " p"]
    right: Bool[np.ndarray, " p"]
    squared: Float64[np.ndarray, " p"]

    @staticmethod
    def of(observed: Observations, noise: MeasurementNoise, prior: TrainingPrior | None) -> PlaceWeights:
        """The places of images as in use: with this noise, and with the prior of the training divided out."""
        score = np.zeros(len(observed.truth)) if observed.score is None else observed.score
        posteriors = tuple(
            PosePosterior.from_samples(samples, noise, ood_score=float(value), prior=prior)
            for samples, value in zip(observed.samples, score, strict=True)
        )
        relative, right, squared = [], [], []
        for i, posterior in enumerate(posteriors):
            truth = observed.truth[np.full(len(posterior.weights), i)]
            metres, radians = posterior.means.distance(truth)
            offset = posterior.means.between(truth).log()
            solved = np.linalg.solve(posterior.covariances, offset[..., None])[..., 0]
            likelihood = posterior.weights if posterior.prior is None else posterior.weights / posterior.prior
            relative.append(likelihood / likelihood.max())
            right.append(np.square(metres / noise.radius_m) + np.square(radians / noise.radius_rad) < 1.0)
            squared.append(np.vecdot(offset, solved))
        image = np.repeat(np.arange(len(posteriors)), [len(each) for each in relative])
        return PlaceWeights(posteriors, image, *map(np.concatenate, (relative, right, squared)))

    def probability(self, noise: MeasurementNoise) -> Float64[np.ndarray, " n"]:
        """Probability of the true place of each image, of which an outlier has none."""
        possible = noise.possible(self.relative)
        share = np.bincount(self.image, possible * self.right) / np.bincount(self.image, possible)
        return noise.outlier_probability + (1.0 - noise.outlier_probability) * np.minimum(share, 1.0)

    def evidence(self, noise: MeasurementNoise) -> Float64[np.ndarray, " n"]:
        """Log likelihood of the true pose by each image, as in `filtering.association.evidence`."""
        near = noise.possible(self.relative) * noise.nearness(self.squared)
        possible = np.minimum(np.bincount(self.image, near), 1.0)
        return np.log(noise.outlier_probability + (1.0 - noise.outlier_probability) * possible)

    def fitted_power(self, noise: MeasurementNoise, worth: float) -> tuple[float, float]:
        """What the log ratio of two weights is worth: `MeasurementNoise.weight_power`.

        The least power that the images do not exclude: a preference that is not shown to be right does not count.

        Args:
            noise: Other settings.
            worth: Number of independent images that one is worth, at most 1.

        Returns:
            The power, and the gain in log likelihood over a power of 0, nats an image.
        """
        powers = [replace(noise, weight_power=float(power)) for power in _POWERS]
        mean = np.array([float(np.log(self.probability(each)).mean()) for each in powers])
        total = worth * len(self.posteriors) * mean
        least = int(np.argmax(total >= total.max() - _NOT_EXCLUDED))
        return float(_POWERS[least]), float(mean[least] - mean[0])

    def reliability(self, noise: MeasurementNoise, worth: float) -> Reliability:
        """Whether the best place of an image is the true one as often as the filter states after this image alone."""
        begins = np.flatnonzero(np.diff(self.image, prepend=-1))
        stated, right = [], []
        for posterior, begin in zip(self.posteriors, begins, strict=True):
            possible = replace(posterior, noise=noise).possible
            shares = possible / possible.sum()
            best = int(np.argmax(shares))
            stated.append((1.0 - noise.outlier_probability) * float(posterior.weights.sum() * shares[best]))
            right.append(self.right[begin + best])
        return Reliability.of(np.array(stated), np.array(right), worth)
