"""Measurement noise: how far the poses of an image err, with which tails, and how errors are correlated."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from filtering.errors import VaporTrackError, require_within
from filtering.unchecked import unchecked_replace

Six = tuple[float, float, float, float, float, float]

LEAST_SCORE, OUT_OF_DISTRIBUTION = 0.05, 1.0
"""Limits of scores: below the first, images count as equally close to the training images; above the second, an image
is out of distribution."""


PLACE = 3.0
"""Standard deviations of the error: finer details do not distinguish places."""


@dataclass(frozen=True)
class MeasurementNoise:
    """Errors of the poses that images give, in the camera frame, fitted on held-out images or stated.

    A cluster of posterior samples with covariance C stands for a place whose error has covariance Σ = spread · C +
    diag(noise_floor²) and the tails of a Student t distribution. Of the error's variance a fraction lasts while the
    view stays the same, and fades as the camera moves and turns (an Ornstein-Uhlenbeck process along the path). Another
    fraction never fades; the rest is independent from image to image. So neither standing nor a higher rate adds
    certainty. What lasts of an error of position is along the axes of the map (`filtering.hypotheses.along_map`).

    Tuples are (x, y, z) along and about the camera's axes, metres and radians.

    Example:
        >>> import vapor
        >>> metres, radians = (0.15, 0.15, 0.15), (0.05, 0.05, 0.05)  # errors of an ordinary image, along each axis
        >>> noise = vapor.MeasurementNoise(radius_m=0.8, typical_std=metres + radians, length_m=0.5)
        >>> noise.scaled(10.0).length_m  # in a place ten times as large
        5.0
    """

    radius_m: float = 0.3
    """Samples within this distance of a peak of the posterior are one cluster, metres."""
    radius_rad: float = 0.5
    """And within this angle, radians."""
    spread: float = 1.0
    """Variance of the error over that of the cluster's samples."""
    noise_floor: Six = (0.05, 0.05, 0.05, 0.03, 0.03, 0.03)
    """Standard deviations of the error that the samples do not show."""
    degrees_of_freedom: float = 6.0
    """Degrees of freedom of the Student t distribution; the fewer, the heavier the tails."""
    outlier_probability: float = 0.05
    """Probability that no place of an image is the true one."""
    log_clutter_density: float = -6.0
    """Log density of poses spread evenly over the map, per m³ rad³: of the true pose of an outlier."""
    possible_fraction: float = 0.05
    """A place with less than this fraction of the heaviest one's weight is less possible, in proportion. A network that
    learned from its best samples knows the possible places, but not their probabilities."""
    weight_power: float = 0.0
    """And with this power of that fraction: 1 where the weights of places are calibrated probabilities."""
    correlated_fraction: float = 0.7
    """Fraction of the error's variance that is the same for images of the same view."""
    length_m: float = 0.5
    """Distance over which that correlation falls to 1/e, and a view becomes a new one, metres."""
    length_rad: float = 0.4
    """Angle over which it does, radians."""
    outlier_lengths: float = 1.0
    """Number of these lengths over which outliers are correlated: a network that takes one corridor for another does so
    along all of it. Less than 1 where outliers fade sooner than errors."""
    constant_fraction: float = 0.1
    """Fraction of the typical variance that remains however many images there are."""
    ood_power: float = 0.0
    """Standard deviations grow with this power of an image's score (`PosePosterior.ood_score`)."""
    typical_ood_score: float = 0.5
    """The score of an image whose errors are as large as stated here."""
    typical_std: Six = (0.07, 0.07, 0.07, 0.04, 0.04, 0.04)
    """Standard deviations of the error of an ordinary image; places, modes and convergence are measured by them."""
    verified: MeasurementNoise | None = None
    """Noise of the places that landmarks have verified; None without a map of landmarks."""

    def __post_init__(self) -> None:
        require_within(
            self,
            radius_m=(1e-9, 1e9),
            radius_rad=(1e-6, 4.0),
            spread=(0.0, 1e6),
            degrees_of_freedom=(1.0, 1e6),
            outlier_probability=(1e-9, 0.999999),
            log_clutter_density=(-1e3, 1e3),
            possible_fraction=(1e-9, 1.0),
            weight_power=(0.0, 10.0),
            correlated_fraction=(0.0, 0.999),
            length_m=(1e-9, 1e9),
            length_rad=(1e-6, 1e3),
            outlier_lengths=(0.01, 1e3),
            constant_fraction=(0.0, 1e3),
            ood_power=(0.0, 3.0),
            typical_ood_score=(0.01, 1.0),
        )
        for name in ("noise_floor", "typical_std"):
            values = getattr(self, name)
            if len(values) != 6 or not all(0.0 < value < 1e9 for value in values):
                raise VaporTrackError(f"{name} is {values}, expected six positive numbers: metres, then radians")
        if self.verified is not None and self.verified.verified is not None:
            raise VaporTrackError("verified places have verified places of their own, expected None")

    def covariance(self, samples: Float64[np.ndarray, "k 6 6"]) -> Float64[np.ndarray, "k 6 6"]:
        """Covariances Σ of the errors of clusters with these covariances of samples."""
        return self.spread * samples + np.diag(np.square(self.noise_floor))

    def growth(self, ood_score: float) -> float:
        """Factor of the variances of an image with this score; 0 is no score."""
        if ood_score == 0.0:
            return 1.0
        score = min(max(ood_score, LEAST_SCORE), OUT_OF_DISTRIBUTION)
        return float((score / self.typical_ood_score) ** (2.0 * self.ood_power))

    def possible(self, weights: Float64[np.ndarray, " k"]) -> Float64[np.ndarray, " k"]:
        """How possible places with these weights are, relative to the heaviest one, in [0, 1]."""
        relative = weights / max(float(weights.max(initial=0.0)), 1e-300)
        possible = np.minimum(relative / self.possible_fraction, 1.0)
        return possible if self.weight_power == 0.0 else possible * relative**self.weight_power

    def nearness(self, squared: Float64[np.ndarray, " p"]) -> Float64[np.ndarray, " p"]:
        """How near poses are to places by squared Mahalanobis distances, from nearly 1 down to 0."""
        near = np.exp(-0.5 * squared / PLACE**2)
        return (1.0 + self.possible_fraction) * near / (near + self.possible_fraction)

    @property
    def finest(self) -> MeasurementNoise:
        """Noise of the most exact places: verified ones where there is a map of landmarks."""
        return self.verified or self

    def ordinary_std(self, covariance: Float64[np.ndarray, "*n 6 6"]) -> Float64[np.ndarray, "*n 6"]:
        """Standard deviations of an ordinary error beside a pose with this covariance (any batch).

        With a map of landmarks they are those of the pose, at least of a verified place, at most of another place.
        """
        if self.verified is None:
            return np.full(covariance.shape[:-1], self.typical_std)
        std = np.sqrt(np.maximum(np.einsum("...ii->...i", covariance), 0.0))
        finest = np.asarray(self.verified.typical_std)
        return np.clip(std, finest, np.maximum(finest, self.typical_std))

    def constant_covariance(self, covariance: Float64[np.ndarray, "*n 6 6"]) -> Float64[np.ndarray, "*n 6 6"]:
        """Covariance of the constant errors, which is added to a belief with this covariance (any batch)."""
        constant = np.zeros(covariance.shape)
        axes = np.einsum("...ii->...i", constant)  # a view
        axes += self.finest.constant_fraction * np.square(self.ordinary_std(covariance))
        return constant

    @property
    def map_size_m(self) -> float:
        """Edge of a cube of the same volume as the map, metres, if all orientations occur."""
        return float(np.exp(-self.log_clutter_density) / (8.0 * np.pi**2)) ** (1.0 / 3.0)

    def inflated(self, factor: float) -> MeasurementNoise:
        """The same with variances times a factor."""
        if factor == 1.0:
            return self
        root = math.sqrt(factor)
        noise_floor = tuple([root * value for value in self.noise_floor])
        typical = tuple([root * value for value in self.typical_std])
        return unchecked_replace(self, spread=factor * self.spread, noise_floor=noise_floor, typical_std=typical)

    def scaled(self, factor: float) -> MeasurementNoise:
        """The same in a map whose lengths are multiplied by a factor."""
        lengths = (factor,) * 3 + (1.0,) * 3
        noise_floor, typical = (
            tuple(value * length for value, length in zip(values, lengths, strict=True))
            for values in (self.noise_floor, self.typical_std)
        )
        return replace(
            self,
            radius_m=factor * self.radius_m,
            noise_floor=noise_floor,
            typical_std=typical,
            length_m=factor * self.length_m,
            log_clutter_density=self.log_clutter_density - 3.0 * float(np.log(factor)),
            verified=None if self.verified is None else self.verified.scaled(factor),
        )
