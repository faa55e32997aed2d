"""How an image's posterior errs: how far, how heavy the tails, and for how long the same way."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from filtering.errors import VaporTrackError, require_within
from filtering.unchecked import unchecked_replace

Six = tuple[float, float, float, float, float, float]

LEAST_SCORE, FOREIGN = 0.05, 1.0
"""Scores of how unlike its training data an image is: nothing is told apart below the one, and an image above the other
is of another place."""


@dataclass(frozen=True)
class ErrorModel:
    """Errors of the poses that images give, in the camera frame, fitted on held-out images or stated.

    A cluster of posterior samples with covariance C stands for a place whose error has covariance Σ = spread · C +
    diag(floor²) and the tails of a Student t distribution. Of the error's variance a fraction lasts while the view
    stays the same, and fades as the camera moves and turns (an Ornstein-Uhlenbeck process along the way); another
    fraction never fades; the rest is new with every image. So neither standing nor a higher rate buys certainty.

    Tuples are (x, y, z) along and about the camera's axes, metres and radians.
    """

    radius_m: float = 0.3
    """Samples within this distance of a peak of the posterior are one cluster, metres."""
    radius_rad: float = 0.5
    """And within this angle, radians."""
    spread: float = 1.0
    """Variance of the error over that of the cluster's samples."""
    floor: Six = (0.05, 0.05, 0.05, 0.03, 0.03, 0.03)
    """Standard deviations of what the samples do not show."""
    tail: float = 6.0
    """Degrees of freedom of the Student t distribution; the fewer, the heavier the tails."""
    outlier_probability: float = 0.05
    """Probability that an image says nothing about where the camera is."""
    flat_log_density: float = -6.0
    """Log density of poses spread evenly over the map, per m³ rad³: where the camera is when an image says nothing."""
    possible_fraction: float = 0.05
    """A place with this fraction of the samples counts half as possible as one with all of them: a network that learned
    from its best samples knows which places are possible, but not how likely each is."""
    lasting_fraction: float = 0.7
    """Fraction of the error's variance that lasts while the view stays the same."""
    length_m: float = 0.5
    """Distance over which that fades to 1/e, and a view becomes a new one, metres."""
    length_rad: float = 0.4
    """Likewise the angle, radians."""
    mistaken_lengths: float = 1.0
    """Over so many of these lengths one image's mistake about the place is the next one's: what takes one floor for
    another does so along all of a corridor; less than 1 where mistakes fade sooner than errors."""
    constant_fraction: float = 0.1
    """Fraction of the typical variance below which no number of images brings the uncertainty of a pose."""
    unfamiliar_power: float = 0.0
    """How errors grow with how unlike its training data an image is: standard deviations with this power of its score
    (`PosePosterior.unfamiliarity`)."""
    unfamiliar_score: float = 0.5
    """The score of an image whose errors are as large as said here."""
    typical_std: Six = (0.07, 0.07, 0.07, 0.04, 0.04, 0.04)
    """Standard deviations of the error of an ordinary image: what makes a place, a mode, a converged estimate."""
    verified: ErrorModel | None = None
    """How places err that landmarks have verified: their spread, floor, tails, and how long that lasts; None without a
    map of landmarks."""

    def __post_init__(self) -> None:
        require_within(
            self,
            radius_m=(1e-9, 1e9),
            radius_rad=(1e-6, 4.0),
            spread=(0.0, 1e6),
            tail=(1.0, 1e6),
            outlier_probability=(1e-9, 0.999999),
            flat_log_density=(-1e3, 1e3),
            possible_fraction=(1e-9, 1e9),
            lasting_fraction=(0.0, 0.999),
            length_m=(1e-9, 1e9),
            length_rad=(1e-6, 1e3),
            mistaken_lengths=(0.01, 1e3),
            constant_fraction=(0.0, 1e3),
            unfamiliar_power=(0.0, 3.0),
            unfamiliar_score=(0.01, 1.0),
        )
        for name in ("floor", "typical_std"):
            values = getattr(self, name)
            if len(values) != 6 or not all(0.0 < value < 1e9 for value in values):
                raise VaporTrackError(f"{name} is {values}, expected six positive numbers: metres, then radians")
        if self.verified is not None and self.verified.verified is not None:
            raise VaporTrackError("verified places have verified places of their own, expected None")

    def covariance(self, samples: Float64[np.ndarray, "k 6 6"]) -> Float64[np.ndarray, "k 6 6"]:
        """Covariance Σ of the errors of clusters of samples with these covariances."""
        return self.spread * samples + np.diag(np.square(self.floor))

    def growth(self, unfamiliarity: float) -> float:
        """How much larger the variances of an image with this score are than those of the model; 0 is no score."""
        if unfamiliarity == 0.0:
            return 1.0
        score = min(max(unfamiliarity, LEAST_SCORE), FOREIGN)
        return float((score / self.unfamiliar_score) ** (2.0 * self.unfamiliar_power))

    @property
    def least_covariance(self) -> Float64[np.ndarray, "6 6"]:
        """What is added to every belief at least: the errors that no number of images takes away."""
        return self.constant_covariance(np.zeros((6, 6)))

    @property
    def finest(self) -> ErrorModel:
        """Of the most exact places that images have: verified ones where there is a map of landmarks."""
        return self.verified or self

    def ordinary_std(self, covariance: Float64[np.ndarray, "*n 6 6"]) -> Float64[np.ndarray, "*n 6"]:
        """What counts as an ordinary error where a pose is known with a covariance (any batch).

        With a map of landmarks: as much as is unknown, at least the error of a verified place, at most that of another.
        """
        if self.verified is None:
            return np.broadcast_to(np.asarray(self.typical_std), covariance.shape[:-1])
        std = np.sqrt(np.maximum(np.einsum("...ii->...i", covariance), 0.0))
        finest = np.asarray(self.verified.typical_std)
        return np.clip(std, finest, np.maximum(finest, self.typical_std))

    def constant_covariance(self, covariance: Float64[np.ndarray, "*n 6 6"]) -> Float64[np.ndarray, "*n 6 6"]:
        """What is added to a belief with this covariance: the errors that no number of images takes away."""
        variances = self.finest.constant_fraction * np.square(self.ordinary_std(covariance))
        return variances[..., None] * np.eye(6)

    @property
    def map_size_m(self) -> float:
        """Edge of a cube that holds as much as the map, metres; orientations are taken to be all."""
        return float(np.exp(-self.flat_log_density) / (8.0 * np.pi**2)) ** (1.0 / 3.0)

    def inflated(self, factor: float) -> ErrorModel:
        """The same with variances that are larger by a factor."""
        if factor == 1.0:
            return self
        root = float(np.sqrt(factor))
        floor = tuple(root * value for value in self.floor)
        typical = tuple(root * value for value in self.typical_std)
        return unchecked_replace(self, spread=factor * self.spread, floor=floor, typical_std=typical)

    def scaled(self, factor: float) -> ErrorModel:
        """The same in a map whose lengths are multiplied by a factor."""
        lengths = (factor,) * 3 + (1.0,) * 3
        floor, typical = (
            tuple(value * length for value, length in zip(values, lengths, strict=True))
            for values in (self.floor, self.typical_std)
        )
        return replace(
            self,
            radius_m=factor * self.radius_m,
            floor=floor,
            typical_std=typical,
            length_m=factor * self.length_m,
            flat_log_density=self.flat_log_density - 3.0 * float(np.log(factor)),
            verified=None if self.verified is None else self.verified.scaled(factor),
        )
