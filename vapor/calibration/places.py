"""Places of images among their posterior samples, and the likelihood of the true poses there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float64, Int64
from scipy.stats import f as fisher
from torch import Tensor

from filtering.measurement_noise import MeasurementNoise, Six
from filtering.moments import group_moments
from filtering.posterior import find_places
from filtering.se3 import Poses
from sequences.odometry_fit.result import six

REGIONS = (0.5, 0.9, 0.95)
"""Probabilities of the regions whose coverage is reported."""
_NEAREST = 8  # fitted places of an image, the nearest to the true pose


@dataclass(frozen=True)
class Observations:
    """Posterior samples, (m,) each, true poses and, if any, OOD scores of n images."""

    samples: Sequence[Poses]
    truth: Poses
    score: Float64[np.ndarray, " n"] | None = None


def log_densities(
    residual: Tensor,
    covariance: Tensor,
    fraction: Tensor,
    spread: Tensor,
    noise_floor: Tensor,
    degrees_of_freedom: Tensor,
) -> tuple[Tensor, Tensor]:
    """Log of fraction times Student t density of each residual, (p,), and its derivatives (p, 8).

    The derivatives are by the logarithms of spread, noise floor (6) and degrees of freedom. Automatic differentiation
    takes twice the time.
    """
    factor = torch.linalg.cholesky(spread * covariance + torch.diag(noise_floor.square()))
    inverse = torch.cholesky_inverse(factor)
    solved = (inverse @ residual[..., None])[..., 0]
    squared = (residual * solved).sum(dim=1)
    half = (degrees_of_freedom + 6.0) / 2.0
    log_volume = torch.diagonal(factor, dim1=1, dim2=2).log().sum(dim=1)
    log_constant = (
        torch.lgamma(half) - torch.lgamma(degrees_of_freedom / 2.0) - 3.0 * torch.log(degrees_of_freedom * np.pi)
    )
    log_far = torch.log1p(squared / degrees_of_freedom)
    by_scale = (
        solved[:, :, None] * solved[:, None, :] * (half / (degrees_of_freedom + squared))[:, None, None] - 0.5 * inverse
    )
    by_degrees_of_freedom = (
        0.5 * (torch.digamma(half) - torch.digamma(degrees_of_freedom / 2.0) - log_far) - 3.0 / degrees_of_freedom
    )
    by_degrees_of_freedom += half * squared / (degrees_of_freedom * (degrees_of_freedom + squared))
    slopes = torch.cat(
        [
            spread * (by_scale * covariance).sum(dim=(1, 2))[:, None],
            2.0 * noise_floor.square() * torch.diagonal(by_scale, dim1=1, dim2=2),
            degrees_of_freedom * by_degrees_of_freedom[:, None],
        ],
        dim=1,
    )
    return fraction.log() + log_constant - log_volume - half * log_far, slopes


def log_sums(terms: Tensor, image: Tensor) -> Tensor:
    """Log of the sum of exponentials over the places of each of n images, given in increasing order, (n,)."""
    count = int(image[-1]) + 1
    top = torch.full((count,), -torch.inf, dtype=terms.dtype).scatter_reduce(0, image, terms.detach(), "amax")
    return top + torch.zeros(count, dtype=terms.dtype).scatter_add(0, image, (terms - top[image]).exp()).log()


@dataclass(frozen=True)
class Places:
    """Places of n images, the nearest to each true pose, by image.

    Attributes:
        residual: The true pose as seen from each place, ξ = (v, ω).
        covariance: Covariance of the samples in each place.
        fraction: Fraction of the image's samples in each place.
        image: Number of the image, in increasing order, every image at least once.
    """

    residual: Float64[np.ndarray, "p 6"]
    covariance: Float64[np.ndarray, "p 6 6"]
    fraction: Float64[np.ndarray, " p"]
    image: Int64[np.ndarray, " p"]

    @staticmethod
    def near(samples: Sequence[Poses], truth: Poses, radius_m: float, radius_rad: float) -> Places:
        """Places of this radius, metres and radians, among samples: for each image the eight nearest to the truth."""
        parts = []
        for poses in samples:
            label, count = find_places(poses, radius_m, radius_rad)
            own = np.flatnonzero(label >= 0)
            means, covariances, _ = group_moments(poses[own], np.ones(len(own)), label[own], count)
            parts.append((means, covariances, np.bincount(label[own], minlength=count) / len(poses)))
        image = np.repeat(np.arange(len(samples)), [len(fraction) for _, _, fraction in parts])
        means = Poses.concatenate([part for part, _, _ in parts])
        residual = (means.inverse() @ truth[image]).log()
        apart = np.linalg.norm(residual[:, :3], axis=1) / radius_m
        apart += np.linalg.norm(residual[:, 3:], axis=1) / radius_rad
        order = np.lexsort([apart, image])
        rank = np.arange(len(image)) - np.searchsorted(image, image)
        kept = order[rank < _NEAREST]
        covariance, fraction = (np.concatenate(part) for part in list(zip(*parts, strict=True))[1:])
        return Places(residual[kept], covariance[kept], fraction[kept], image[kept])

    def grown(self, noise: MeasurementNoise, score: Float64[np.ndarray, " n"]) -> Places:
        """The places rescaled as if every image had the ordinary score: g⁻³ t(ξ/√g; Σ) is t(ξ; g Σ)."""
        growth = np.array([noise.growth(float(value)) for value in score])[self.image]
        return replace(self, residual=self.residual / np.sqrt(growth)[:, None], fraction=self.fraction / growth**3)

    def log_density(self, noise: MeasurementNoise) -> Float64[np.ndarray, " n"]:
        """Log density of the true pose of each image, per m³ rad³."""
        log_places = log_sums(torch.from_numpy(self._log_terms(noise)), torch.from_numpy(self.image)).numpy()
        outliers = noise.outlier_probability
        return np.logaddexp(np.log(outliers) + noise.log_clutter_density, np.log1p(-outliers) + log_places)

    def residuals(self, noise: MeasurementNoise) -> tuple[Float64[np.ndarray, "n 6"], Bool[np.ndarray, " n"]]:
        """Errors of the likeliest places in standard deviations, and the mask of images that beat a flat density.

        Large errors are reduced by the weight of a Student t distribution.
        """
        best = self._likeliest(noise)
        unit = np.asarray(self.typical_std(noise))
        covariance = noise.covariance(self.covariance[best]) / np.multiply.outer(unit, unit)
        values, vectors = np.linalg.eigh(covariance)
        normal = np.einsum("nij,nj->ni", np.swapaxes(vectors, 1, 2), self.residual[best] / unit)
        normal = np.einsum("nij,nj->ni", vectors, normal / np.sqrt(values))
        weight = (noise.degrees_of_freedom + 6.0) / (noise.degrees_of_freedom + np.square(normal).sum(axis=1))
        log_odds = np.log1p(-noise.outlier_probability) - np.log(noise.outlier_probability)
        terms = torch.from_numpy(self._log_terms(noise))
        log_places = log_sums(terms, torch.from_numpy(self.image)).numpy()
        return normal * np.sqrt(np.minimum(weight, 1.0))[:, None], log_places + log_odds > noise.log_clutter_density

    def coverage(self, noise: MeasurementNoise) -> tuple[float, float, float]:
        """Fractions of the images whose true pose is in the 50, 90 and 95 % region of its likeliest place."""
        squared = self._squared(noise)
        fifty, ninety, most = (
            float((squared <= 6.0 * fisher.ppf(q, 6, noise.degrees_of_freedom)).mean()) for q in REGIONS
        )
        return fifty, ninety, most

    def lacking(self, noise: MeasurementNoise, region: float) -> float:
        """Factor ≥ 1 of the variances with which the region of this probability holds that fraction of the poses."""
        reached = float(np.quantile(self._squared(noise), region, method="higher"))
        return max(1.0, reached / float(6.0 * fisher.ppf(region, 6, noise.degrees_of_freedom)))

    def _squared(self, noise: MeasurementNoise) -> Float64[np.ndarray, " n"]:
        best = self._likeliest(noise)
        covariance = noise.covariance(self.covariance[best])
        solved = np.linalg.solve(covariance, self.residual[best][..., None])[..., 0]
        return np.einsum("ni,ni->n", self.residual[best], solved)

    def typical_std(self, noise: MeasurementNoise) -> Six:
        """Standard deviations of the error of the likeliest place, median over the images."""
        variances = np.diagonal(noise.covariance(self.covariance[self._likeliest(noise)]), axis1=1, axis2=2)
        return six(np.sqrt(np.median(variances, axis=0)))

    def _likeliest(self, noise: MeasurementNoise) -> Int64[np.ndarray, " n"]:
        order = np.lexsort([-self._log_terms(noise), self.image])
        return order[np.flatnonzero(np.diff(self.image, prepend=-1))]

    def _log_terms(self, noise: MeasurementNoise) -> Float64[np.ndarray, " p"]:
        terms, _ = log_densities(
            torch.from_numpy(self.residual),
            torch.from_numpy(self.covariance),
            torch.from_numpy(self.fraction),
            torch.tensor(noise.spread, dtype=torch.float64),
            torch.tensor(noise.noise_floor, dtype=torch.float64),
            torch.tensor(noise.degrees_of_freedom, dtype=torch.float64),
        )
        return terms.numpy()
