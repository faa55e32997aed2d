"""The posterior of one image: a mixture of Gaussians on SE(3), with its measurement noise."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float64, Int64

from filtering.errors import VaporTrackError
from filtering.mapped_views import MappedViews
from filtering.measurement_noise import OUT_OF_DISTRIBUTION, MeasurementNoise
from filtering.moments import group_moments
from filtering.se3 import Poses
from filtering.training_prior import TrainingPrior
from filtering.unchecked import unchecked_replace

if TYPE_CHECKING:
    from filtering.plots import Axes

_SOUGHT = 250  # samples among which peaks are sought
_KERNEL_APART = np.exp(-2.0 * 1.5**2)  # of two samples that are 1.5 radii apart
_MOST_PLACES = 40
_LEAST_FRACTION = 0.01  # of the samples: fewer are no place of their own


@dataclass(frozen=True)
class PosePosterior:
    """The distribution of camera poses for one image: places where the camera may be, each a Gaussian.

    Attributes:
        means: world_from_camera of each place, batch (k,); empty for an image without information.
        covariances: Of the error ξ = (v, ω) of each, metres and radians, in the tangent at the mean, (k, 6, 6).
        weights: Of each place in the posterior, at least 0, in all 1 at most, (k,).
        noise: Noise of the places.
        samples: Samples of the posterior, world_from_camera, batch (m,), for display; the means where there are none.
        ood_score: Distance of the image from the training images: near 0 for one of them, 1 at the threshold,
            above it the image is out of distribution and carries no information. 0 without a score.
        growth: Factor of the variances that follows from the score.
        verified: Whether landmarks have verified each place, whose noise is then `noise.verified`, (k,); None for
            none.
        calibrated: Whether the covariances are scale matrices of the noise's Student t distribution, as calibration
            fits them, rather than covariances as somebody states them.
        prior: Density of training poses at each place, in any unit, above 0, (k,); None for an even one. The weights
            contain it, which counts once; it is divided out of what further images add.
        mapped: Where landmarks can verify places; None for everywhere. Only the particle filter uses it.

    Example:
        >>> import numpy as np
        >>> import vapor
        >>> places = vapor.Poses.from_quat_xyzw([[1, 2, 0], [1, 6, 0]], [[0, 0, 0, 1], [0, 0, 0, 1]])
        >>> noise = vapor.MeasurementNoise()
        >>> posterior = vapor.PosePosterior.from_estimates(places, std_m=0.1, std_rad=0.05, noise=noise)
        >>> rng = np.random.default_rng(0)
        >>> drawn = places[rng.integers(2, size=500)] @ vapor.Poses.exp(0.1 * rng.standard_normal((500, 6)))
        >>> len(vapor.PosePosterior.from_samples(drawn, noise).means)
        2
        >>> axes = posterior.plot(truth=places[0])
    """

    means: Poses
    covariances: Float64[np.ndarray, "k 6 6"]
    weights: Float64[np.ndarray, " k"]
    noise: MeasurementNoise
    samples: Poses
    ood_score: float = 0.0
    growth: float = 1.0
    verified: Bool[np.ndarray, " k"] | None = None
    mapped: MappedViews | None = None
    calibrated: bool = False
    prior: Float64[np.ndarray, " k"] | None = None

    def __post_init__(self) -> None:
        count = len(self.means)
        if self.verified is not None and (self.verified.shape != (count,) or self.noise.verified is None):
            raise VaporTrackError(
                f"posterior: verified has shape {self.verified.shape}, expected ({count},) and errors of such places"
            )
        if self.prior is not None and not (self.prior.shape == (count,) and (self.prior > 0.0).all()):
            raise VaporTrackError(f"posterior: prior is {self.prior.tolist()}, expected {count} numbers above 0")
        for name, shape in (("covariances", (count, 6, 6)), ("weights", (count,))):
            values = getattr(self, name)
            if values.shape != shape:
                raise VaporTrackError(f"posterior: {name} have shape {values.shape}, expected {shape}")
            _require_finite(name, values)
        _require_finite("means", self.means.translation, self.means.rotation)
        if not (self.weights >= 0.0).all() or self.weights.sum() > 1.0 + 1e-6:
            raise VaporTrackError(f"posterior: weights are {self.weights.tolist()}, expected at least 0 and 1 in all")
        uneven = np.abs(self.covariances - np.swapaxes(self.covariances, 1, 2)).max(axis=(1, 2), initial=0.0)
        if (uneven > 1e-6 * np.abs(self.covariances).max(axis=(1, 2), initial=0.0)).any():
            raise VaporTrackError(f"posterior: covariance {int(np.argmax(uneven))} of {count} is not symmetric")
        try:
            np.linalg.cholesky(self.covariances)
        except np.linalg.LinAlgError:
            raise VaporTrackError("posterior: a covariance is singular or has a negative eigenvalue") from None
        if not self.ood_score >= 0.0:  # NaN compares as false
            raise VaporTrackError(f"posterior: ood_score is {self.ood_score}, expected 0 or more")

    @staticmethod
    def from_samples(
        samples: Poses, noise: MeasurementNoise, *, ood_score: float = 0.0, prior: TrainingPrior | None = None
    ) -> PosePosterior:
        """The places among posterior samples (m,), m ≥ 1, weighted by their fractions of the samples.

        `prior` is that of the network's training; None where it is even.

        Raises:
            VaporTrackError: no sample, or one that is not finite.
        """
        if len(samples) == 0:
            raise VaporTrackError("a posterior needs at least one sample, got an empty batch of poses")
        _require_finite("samples", samples.translation, samples.rotation)
        label, count = find_places(samples, noise.radius_m, noise.radius_rad)
        own = np.flatnonzero(label >= 0)
        means, covariances, _ = group_moments(samples[own], np.ones(len(own)), label[own], count)
        weights = np.bincount(label[own], minlength=count) / len(samples)
        growth = noise.growth(ood_score)
        covariances = growth * noise.covariance(covariances)
        density = None if prior is None else prior.density(means)
        return PosePosterior(
            means, covariances, weights, noise, samples, ood_score, growth, calibrated=True, prior=density
        )

    @staticmethod
    def from_estimates(
        estimates: Poses,
        std_m: float | Float64[np.ndarray, " m"],
        std_rad: float | Float64[np.ndarray, " m"],
        noise: MeasurementNoise,
        *,
        weights: Float64[np.ndarray, " m"] | None = None,
    ) -> PosePosterior:
        """The posterior of an image with several estimates of its pose, of which one is right, or none.

        Args:
            estimates: world_from_camera, batch (m,), m ≥ 1.
            std_m: Stated standard deviation along each axis, metres; of all estimates or of each.
            std_rad: Stated standard deviation about each axis, radians; of all estimates or of each.
            noise: Of them; how much the weights count follows from its `weight_power`.
            weights: Probability that each is the right one, at least 0, in all 1 at most; None for equal ones.

        Raises:
            VaporTrackError: no estimate, or a number out of its range.
        """
        count = len(estimates)
        if count == 0:
            raise VaporTrackError("no estimate, expected at least one")
        for name, std in (("std_m", std_m), ("std_rad", std_rad)):
            if np.shape(std) not in ((), (count,)):
                raise VaporTrackError(f"{name} has shape {np.shape(std)}, expected one number or ({count},)")
        stds = [np.broadcast_to(std, count)[:, None].repeat(3, axis=1) for std in (std_m, std_rad)]
        variances = np.square(np.concatenate(stds, axis=1))
        weights = np.full(count, 1.0 / count) if weights is None else np.asarray(weights, np.float64)
        return PosePosterior(estimates, variances[:, :, None] * np.eye(6), weights, noise, estimates)

    @staticmethod
    def uninformative(noise: MeasurementNoise | None = None, samples: Poses | None = None) -> PosePosterior:
        """The posterior of an image without information: it changes no belief."""
        none = Poses.identity(0)
        return PosePosterior(none, np.zeros((0, 6, 6)), np.zeros(0), noise or MeasurementNoise(), samples or none)

    def heaviest(self, count: int) -> PosePosterior:
        """The same with the heaviest places only, at most so many, by falling weight, and without samples."""
        kept = np.argsort(-self.weights, kind="stable")[:count]
        return unchecked_replace(
            self,
            means=self.means[kept],
            covariances=self.covariances[kept],
            weights=self.weights[kept],
            samples=self.means[kept],
            verified=None if self.verified is None else self.verified[kept],
            prior=None if self.prior is None else self.prior[kept],
        )

    def without_places(self) -> PosePosterior:
        """The same without any place, with its score."""
        return replace(PosePosterior.uninformative(self.noise, self.samples), ood_score=self.ood_score)

    @property
    def is_out_of_distribution(self) -> bool:
        """Whether the image is too unlike the training images to be of their place."""
        return self.ood_score > OUT_OF_DISTRIBUTION

    @property
    def is_uninformative(self) -> bool:
        """Whether it has no place of any weight, or is out of distribution."""
        return not self.weights.any() or self.is_out_of_distribution

    @cached_property
    def variances(self) -> tuple[Float64[np.ndarray, " k"], Float64[np.ndarray, " k"]]:
        """Of each place, all axes together, m² and rad², (k,) each."""
        position, rotation = (np.einsum("kii->k", self.covariances[:, part, part]) for part in (slice(3), slice(3, 6)))
        return position, rotation

    @property
    def has_verified(self) -> bool:
        """Whether landmarks have verified any place."""
        return len(self.sources[1]) > 0

    @cached_property
    def outlier_probability(self) -> float:
        """Probability that no place is the true one: no verified one, where places are verified."""
        return (self.noise.finest if self.has_verified else self.noise).outlier_probability

    def excuse(self, poses: Poses) -> Float64[np.ndarray, " n"]:
        """Probability, for each of n poses, that its view is not in the map, so that other places are verified,
        (n,)."""
        if self.mapped is None or not self.has_verified:
            return np.zeros(len(poses))
        return self.mapped.excuse(poses)

    def outliers(self, excuse: Float64[np.ndarray, " n"], outlier_places: float = 1.0) -> Float64[np.ndarray, " n"]:
        """Probability, at each of n right poses, that the image shows another place, or one of so many others, (n,).

        Args:
            excuse: Of the poses, see `excuse`, (n,).
            outlier_places: An outlier shows one of so many places.
        """
        outlier = self.outlier_probability / outlier_places
        return outlier + (1.0 - outlier) * excuse

    def log_likelihood(
        self, possible: Float64[np.ndarray, " n"], excuse: Float64[np.ndarray, " n"], outlier_places: float
    ) -> Float64[np.ndarray, " n"]:
        """Log likelihood of n poses, from the log of the probability of an outlier to 0, (n,).

        Args:
            possible: How possible each is by the places near it, in [0, 1], (n,).
            excuse, outlier_places: See `outliers`.
        """
        mistaken = self.outliers(excuse, outlier_places)
        return np.log(mistaken + (1.0 - mistaken) * possible)

    @cached_property
    def possible(self) -> Float64[np.ndarray, " k"]:
        """How possible each place is, in [0, 1], see `MeasurementNoise.possible`.

        Weights of verified places relative to others were calibrated on held-out images: beside verified places,
        lighter ones are possible in proportion to their weight.
        """
        network, verified = self.sources
        if not len(verified):
            return self.noise.possible(self.weights if self.prior is None else self.weights / self.prior)
        possible, own = self.noise.finest.possible(self.weights), self.weights[network]
        total = max(float(self.weights[verified].sum()), 1e-300)
        possible[network] = np.minimum(possible[network], own / total)
        return possible

    @cached_property
    def shares(self) -> Float64[np.ndarray, " k"]:
        """Shares of the places in what the image assigns, 1 in all: by their weights as far as these are calibrated, at
        least by their square roots."""
        noise = self.noise.finest if self.has_verified else self.noise
        tilt = max(0.5 - noise.weight_power, 0.0)
        possible = self.possible if self.has_verified else noise.possible(self.weights)
        shares = possible * self.weights**tilt
        return shares / max(float(shares.sum()), 1e-300)

    @cached_property
    def factors(self) -> Float64[np.ndarray, "k 6 6"]:
        """Square roots of the covariances, symmetric in units of an ordinary image's error: the same in any unit."""
        unit = np.asarray(self.noise.typical_std)
        values, vectors = np.linalg.eigh(self.covariances / np.multiply.outer(unit, unit))
        return unit[:, None] * ((vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]) @ np.swapaxes(vectors, 1, 2))

    @cached_property
    def sources(self) -> tuple[Int64[np.ndarray, " a"], Int64[np.ndarray, " b"]]:
        """Indices of the places of some weight that the network proposes, and of those that landmarks have verified."""
        if self.verified is None:
            return self.weights.nonzero()[0], np.empty(0, np.int64)
        possible = self.weights > 0.0
        return (~self.verified & possible).nonzero()[0], (self.verified & possible).nonzero()[0]

    def noise_of(self, source: int) -> MeasurementNoise:
        """Noise of the places of a source, by its number in `sources`."""
        return self.noise if source == 0 else self.noise.finest

    def of_source(self, source: int) -> PosePosterior:
        """The places of one source, with their noise."""
        places = self.sources[source]
        if source == 0 and len(places) == len(self.weights):
            return self
        return unchecked_replace(
            self,
            means=self.means[places],
            covariances=self.covariances[places],
            weights=self.weights[places],
            prior=None if self.prior is None else self.prior[places],
            noise=self.noise_of(source),
            growth=self.growth if source == 0 else 1.0,
            verified=None,
        )

    def inflated(self, factor: float, of_verified: float = 1.0) -> PosePosterior:
        """The same with variances times a factor, those of verified places times another."""
        if factor == of_verified == 1.0:
            return self
        factors = np.full(len(self.weights), factor)
        factors[self.sources[1]] = of_verified
        noise = self.noise.inflated(factor)
        if noise.verified is not None:
            noise = unchecked_replace(noise, verified=noise.verified.inflated(of_verified))
        larger = unchecked_replace(self, covariances=factors[:, None, None] * self.covariances, noise=noise)
        # Filter and baselines share one decomposition.
        vars(larger)["factors"] = np.sqrt(factors)[:, None, None] * self.factors
        return larger

    def plot(
        self,
        axes: Axes | None = None,
        *,
        plane: str | None = None,
        truth: Poses | None = None,
        probability: float = 0.9,
    ) -> Axes:
        """Draw the places from above, with their regions, directions of view and weights, and the samples.

        Arguments and errors are those of `Estimate.plot`.
        """
        from filtering.estimate import posterior_modes  # which needs this module
        from filtering.plots import Plan

        modes = posterior_modes(self)
        plan = Plan(axes, plane, self.means if len(modes) else self.samples)
        plan.points(self.samples, "samples", size=3.0)
        plan.modes(modes, probability, "place")
        if truth is not None:
            plan.truth(truth)
        known = "no place" if not modes else "1 place" if len(modes) == 1 else f"{len(modes)} places"
        return plan.finish(f"{known}, out of distribution" if self.is_out_of_distribution else known)

    def seen_from(self, reference_from_camera: Poses) -> PosePosterior:
        """The posterior of another frame that is fixed to the camera (one pose)."""
        if reference_from_camera.is_identity:
            return self
        carry = reference_from_camera.adjoint()
        camera_from_reference = reference_from_camera.inverse()
        there = replace(
            self,
            means=self.means @ camera_from_reference,
            covariances=carry @ self.covariances @ carry.T,
            samples=self.samples @ camera_from_reference,
            mapped=None if self.mapped is None else self.mapped.seen_from(reference_from_camera),
        )
        # The same error of the camera, along the axes of the map: as `filtering.hypotheses.along_map` has it.
        factors = carry @ self.factors
        factors[:, :, :3] = factors[:, :, :3] @ reference_from_camera.rotation.T
        vars(there)["factors"] = factors
        return there


@runtime_checkable
class ObservationModel(Protocol):
    """Maps an image to its posterior: one network call per image.

    Example:
        >>> import numpy as np
        >>> import vapor
        >>> class Mine:
        ...     def observe(self, image, *, rng):
        ...         place = vapor.Poses.from_quat_xyzw([[image.mean() / 255, 0, 0]], [[0, 0, 0, 1]])  # your network
        ...         return vapor.PosePosterior.from_estimates(place, 0.1, 0.05, vapor.MeasurementNoise())
        >>> localizer = vapor.ParticleLocalizer(Mine(), rng=np.random.default_rng(0))
        >>> estimate = localizer.step(np.full((48, 64, 3), 255, np.uint8), None)
        >>> estimate.modes[0].world_from_camera.translation.round(1)
        array([1., 0., 0.])
    """

    def observe(self, image: np.ndarray, *, rng: np.random.Generator) -> PosePosterior:
        """The posterior of one image, (H, W, 3) uint8 RGB."""
        ...


def find_places(samples: Poses, radius_m: float, radius_rad: float) -> tuple[Int64[np.ndarray, " m"], int]:
    """Split samples (m,) into places.

    Peaks of the density among some of the samples are taken from the highest down, none within 1.5 radii of another;
    each then moves once to the mean of the samples within its radius, and every sample belongs to the nearest one.

    Args:
        samples: world_from_camera, m ≥ 1.
        radius_m: Reach of a place, metres.
        radius_rad: Reach of a place, radians.

    Returns:
        The place of every sample from 0, −1 where it belongs to none, and the number of places.
    """
    count = len(samples)
    # Squared distances between these are (metres / radius)² + (2 − 2 cos angle) / radius².
    embedded = np.concatenate(
        [samples.translation / radius_m, samples.rotation.reshape(-1, 9) / (np.sqrt(2.0) * radius_rad)], axis=1
    )
    some = slice(None, None, max(1, count // _SOUGHT))
    embedded -= np.median(embedded[some][::10], axis=0)  # distances are differences of large numbers where it is far
    sought = embedded[some].copy()
    squares = np.vecdot(embedded, embedded)
    # The kernel of every pair, exp(−2 × squared distance): −2|a|² + 4ab − 2|b|² is one product.
    own, one = squares[some, None], np.ones((len(sought), 1))
    kernel = (
        np.concatenate([4.0 * sought, -2.0 * own, one], axis=1) @ np.concatenate([sought, one, -2.0 * own], axis=1).T
    )
    kernel = np.minimum(kernel, 0.0, out=np.empty(kernel.shape, np.float32), casting="same_kind")
    height = np.exp(kernel, out=kernel).sum(axis=1)
    peaks: list[int] = []
    free = np.argsort(-height, kind="stable")  # from the highest down
    least = max(1.5, _LEAST_FRACTION * len(height))
    while len(free) and len(peaks) < _MOST_PLACES and not (peaks and height[free[0]] < least):
        peaks.append(free[0])
        free = free[kernel[free[0], free] < _KERNEL_APART]
    centres = sought[peaks]
    label = _nearest(embedded, squares, centres)
    member = (label == np.arange(len(centres))[:, None]).astype(np.float64)
    size = member.sum(axis=1, keepdims=True)
    centres = np.where(size > 0, member @ embedded / np.maximum(size, 1.0), centres)
    label = _nearest(embedded, squares, centres)
    sizes = np.bincount(label + 1, minlength=len(centres) + 1)[1:]
    kept = sizes >= max(min(3, count), _LEAST_FRACTION * count)
    if not kept.any():
        kept[np.argmax(sizes)] = True
    renumbered = np.append(np.where(kept, np.cumsum(kept) - 1, -1), -1)
    return renumbered[label].astype(np.int64), int(kept.sum())


def _nearest(embedded: np.ndarray, squares: np.ndarray, centres: np.ndarray) -> Int64[np.ndarray, " m"]:
    """Index of the nearest centre, −1 where none is within 1; the first one for the sample nearest to any."""
    distance = np.vecdot(centres, centres)[:, None] - 2.0 * centres @ embedded.T  # and their own squares
    nearest = distance.argmin(axis=0)
    least = distance.min(axis=0) + squares
    inside = least <= 1.0
    if not inside.any():
        inside[np.argmin(least)] = True
    return np.where(inside, nearest, -1)


def _require_finite(name: str, *arrays: Float64[np.ndarray, "n ..."]) -> None:
    if not all(np.isfinite(values).all() for values in arrays):
        finite = np.all([np.isfinite(values).reshape(len(values), -1).all(axis=1) for values in arrays], axis=0)
        raise VaporTrackError(f"posterior: {name} {int(np.argmin(finite))} of {len(finite)} is not finite")
