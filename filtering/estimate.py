"""The estimate of a belief: its modes, each with weight and covariance, and its status."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Literal, NamedTuple, get_args

import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy.special import chdtri, fdtri

from filtering.errors import VaporTrackError, require_within
from filtering.hypotheses import Hypotheses
from filtering.measurement_noise import MeasurementNoise
from filtering.moments import mixture_moments
from filtering.motion import GapMotion
from filtering.posterior import PosePosterior
from filtering.se3 import Poses

if TYPE_CHECKING:
    from filtering.plots import Axes

SHOWN_PARTICLES = 300
"""Of a belief in messages, recordings and reports."""
_MARGIN = 1.01  # of a squared distance of hypotheses that are compared in full

_GAUSSIAN = 1e6  # degrees of freedom from which on a Student t distribution is taken as Gaussian

Status = Literal["converged", "ambiguous", "lost"]
STATUSES: tuple[Status, ...] = get_args(Status)


class Innovation(NamedTuple):
    """How far an image is from where a mode was expected to see it (Bar-Shalom et al. 2001, §5.4).

    Attributes:
        squared: Normalised innovation squared yᵀ S⁻¹ y of the place nearest to the mode, before the image corrects it;
            summed over the images of a step. S is the innovation's covariance by the belief and the ordinary error.
        degrees_of_freedom: 6 for each of these images: what it is on average where the errors are Gaussian and as
            large as stated. Tails of a Student t distribution make it larger.

    Example:
        >>> import numpy as np
        >>> import vapor
        >>> places = vapor.Poses.from_quat_xyzw([[1, 2, 0], [1, 6, 0]], [[0, 0, 0, 1], [0, 0, 0, 1]])
        >>> posterior = vapor.PosePosterior.from_estimates(places, 0.1, 0.05, vapor.MeasurementNoise())  # m, rad
        >>> localizer = vapor.ParticleLocalizer(None, rng=np.random.default_rng(0))
        >>> estimate = localizer.update(posterior, None)
        >>> one_metre = vapor.Poses.from_quat_xyzw([1, 0, 0], [0, 0, 0, 1])
        >>> odometry = vapor.Odometry(one_metre, 1e-4 * np.eye(6), duration_s=1.0)
        >>> seen = vapor.PosePosterior.from_estimates(places @ one_metre, 0.1, 0.05, vapor.MeasurementNoise())
        >>> innovation = localizer.update(seen, odometry).modes[0].innovation
        >>> innovation.squared < innovation.degrees_of_freedom  # nearer than usual
        True
    """

    squared: float
    degrees_of_freedom: int


def squared_radius(
    probability: float, degrees_of_freedom: float | Float64[np.ndarray, " n"], dimensions: int = 6
) -> Float64[np.ndarray, "*n"]:
    """Squared Mahalanobis distances within which poses are with a probability, of one mode or of n.

    The six components of the error, and so many of them by themselves, have a Student t distribution; it is Gaussian
    where the degrees of freedom are infinite.

    Raises:
        VaporTrackError: the probability is not between 0 and 1.
    """
    if not 0.0 < probability < 1.0:
        raise VaporTrackError(f"region of probability {probability}, expected one between 0 and 1")
    nu = np.asarray(degrees_of_freedom, np.float64)
    student = dimensions * fdtri(dimensions, np.minimum(nu, _GAUSSIAN), probability)
    return np.where(nu < _GAUSSIAN, student, chdtri(dimensions, 1.0 - probability))


@dataclass(frozen=True)
class Mode:
    """One hypothesis of where the camera is.

    Attributes:
        world_from_camera: One pose, the mean of the mode.
        covariance: Covariance of ξ = (v, ω), metres and radians, in the tangent at the mode (camera frame).
        weight: Probability that the camera is there, in [0, 1].
        verified: Whether it is a place of one image, verified by landmarks.
        identity: The same from step to step while the mode goes on; never given again. -1 for places of one image and
            for the one mode of a baseline.
        innovation: Of the images of this step; None without any, where none of their places is near, and for a mode
            that is new.
        degrees_of_freedom: Of the Student t distribution of the error, whose scale matrix is the covariance; infinite
            for a Gaussian. That of one calibrated image has the image's tails, that of many is nearly Gaussian.

    Example:
        >>> import numpy as np
        >>> import vapor
        >>> places = vapor.Poses.from_quat_xyzw([[1, 2, 0], [1, 6, 0]], [[0, 0, 0, 1], [0, 0, 0, 1]])
        >>> posterior = vapor.PosePosterior.from_estimates(places, 0.1, 0.05, vapor.MeasurementNoise())  # m, rad
        >>> localizer = vapor.ParticleLocalizer(None, rng=np.random.default_rng(0))
        >>> estimate = localizer.update(posterior, None)
        >>> best = estimate.modes[0]
        >>> best.world_from_camera.translation.round(1), round(best.weight, 3), best.identity
        (array([1., 2., 0.]), 0.475, 0)
        >>> best.contains(vapor.Poses.from_quat_xyzw([1.1, 2, 0], [0, 0, 0, 1]), 0.9)
        array(True)
    """

    world_from_camera: Poses
    covariance: Float64[np.ndarray, "6 6"]
    weight: float
    verified: bool = False
    identity: int = -1
    innovation: Innovation | None = None
    degrees_of_freedom: float = np.inf

    def squared_radius(self, probability: float, dimensions: int = 6) -> float:
        """Squared Mahalanobis distance within which the true pose is with a probability, if the mode is right.

        Of so many dimensions by themselves, such as two of the position.

        Raises:
            VaporTrackError: the probability is not between 0 and 1.
        """
        return float(squared_radius(probability, self.degrees_of_freedom, dimensions))

    def contains(self, poses: Poses, probability: float) -> Bool[np.ndarray, "*n"]:
        """Which poses (any batch) lie in the mode's region of a probability, in all six dimensions.

        Raises:
            VaporTrackError: the probability is not between 0 and 1.
        """
        error = self.world_from_camera.between(poses).log()
        squared = np.vecdot(error, np.linalg.solve(self.covariance, error[..., None])[..., 0])
        return np.asarray(squared <= self.squared_radius(probability))

    @property
    def widest_std_m(self) -> float:
        """Standard deviation of the position along its widest axis, metres."""
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance[:3, :3])[-1]))


@dataclass(frozen=True)
class ModeConfig:
    """Which hypotheses make one mode, in standard deviations of an ordinary image's error
    (`MeasurementNoise.typical_std`)."""

    radius: float = 8.0
    """Hypotheses within so many standard deviations of a heavier one, along each axis, are one mode."""
    least_rad: float = 0.2
    """The angle is at least this, radians."""
    most_rad: float = 0.6
    """And at most this, radians."""
    max_modes: int = 12
    """Largest number of modes."""
    min_weight: float = 0.02
    """Modes of smaller weight are not reported."""

    def __post_init__(self) -> None:
        require_within(
            self,
            radius=(1e-3, 1e6),
            least_rad=(0.0, 4.0),
            most_rad=(self.least_rad, 4.0),
            max_modes=(1, 10**6),
            min_weight=(0.0, 1.0),
        )

    def same_place(self, poses: Poses, mode: Mode, noise: MeasurementNoise) -> Bool[np.ndarray, "*n"]:
        """Which poses (any batch) lie within the reach of a mode, along each of its camera's axes."""
        return _within(mode.world_from_camera.between(poses).log(), self.reach(noise, mode.covariance))

    def reach(self, noise: MeasurementNoise, covariance: Float64[np.ndarray, "*n 6 6"]) -> Float64[np.ndarray, "*n 6"]:
        """How far modes with these covariances reach, along and about each of their axes, metres and radians."""
        reach = self.radius * noise.ordinary_std(covariance)
        reach[..., 3:] = np.minimum(np.maximum(reach[..., 3:], self.least_rad), self.most_rad)
        return reach


@dataclass(frozen=True)
class Estimate:
    """The estimate after one step.

    Attributes:
        modes: The best one first, the others by falling weight.
        status: "converged" when one narrow mode holds most of the belief and the latest images fit it,
            "lost" when these fit nothing in it, "ambiguous" otherwise.
        particles: All hypotheses, world_from_camera, batch (n,): Rao-Blackwellised particles, each the middle of a
            Gaussian.
        covariances: Of each, of ξ = (v, ω) in the tangent at it, (n, 6, 6).
        log_weights: Their normalised log weights, (n,).
        unassigned: Probability that the camera is at none of them: the weights of all modes and this are 1 in all.
        log_likelihood: Log marginal likelihood of the step's images, at most 0, summed over them; 0 without any. It is
            that of which place they show, relative to images that fit all of the belief:
            log(u + (1 − u) Σ w (ε + (1 − ε) p)^λ) over the hypotheses, with weight w, probability ε that an outlier
            shows the place by chance, and p in [0, 1] for how possible each is; u is unassigned, and fits. Correlated
            images count once: λ is the novelty. Where in the place it is, is not part of it, see `Mode.innovation`.
        agreement: Share of the belief that the latest images fitted, in [0, 1].
        novelty: Fraction of the image's information that earlier images lack, in [0, 1].
        normalized_distance: That the camera moved since the image before, in lengths over which the errors of its
            images are correlated.
        ood_score: Of the image, see `PosePosterior`; 0 where there was none.
        odometry_scale_error: Found in the odometry: where it is positive, reported distances are too long.
        gap_motion: How the camera moved in this step, where odometry was missing.
        left_out: Names of the cameras of this step whose views fit nowhere while those of the others fit.

    Example:
        >>> import numpy as np
        >>> import vapor
        >>> places = vapor.Poses.from_quat_xyzw([[1, 2, 0], [1, 6, 0]], [[0, 0, 0, 1], [0, 0, 0, 1]])
        >>> posterior = vapor.PosePosterior.from_estimates(places, 0.1, 0.05, vapor.MeasurementNoise())  # m, rad
        >>> localizer = vapor.ParticleLocalizer(None, rng=np.random.default_rng(0))
        >>> estimate = localizer.update(posterior, None)
        >>> estimate.status
        'ambiguous'
        >>> [round(mode.weight, 3) for mode in estimate.modes], round(estimate.unassigned, 3)
        ([0.475, 0.475], 0.05)
        >>> axes = estimate.plot()  # from above, with 90 % regions; axes.figure.savefig("belief.png")
    """

    modes: tuple[Mode, ...]
    status: Status
    particles: Poses
    covariances: Float64[np.ndarray, "n 6 6"]
    log_weights: Float64[np.ndarray, " n"]
    unassigned: float
    log_likelihood: float
    agreement: float
    novelty: float
    normalized_distance: float
    ood_score: float
    odometry_scale_error: float = 0.0
    gap_motion: GapMotion | None = None
    left_out: tuple[str, ...] = ()

    @property
    def effective_sample_size(self) -> float:
        """1 / Σ w², between 1 and n, in particles (Kong et al. 1994)."""
        return float(1.0 / np.exp(2.0 * self.log_weights).sum())

    def cloud(self, count: int) -> Poses:
        """Poses (count,) of equal weight that represent the belief; equal for equal beliefs."""
        cumulative = np.cumsum(np.exp(self.log_weights))
        steps = (np.arange(count) + 0.5) / count * cumulative[-1]
        which = np.minimum(np.searchsorted(cumulative, steps), len(self.log_weights) - 1)
        values, vectors = np.linalg.eigh(self.covariances)
        factor = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
        draws = np.random.default_rng(0).standard_normal((count, 6, 1))
        return self.particles[which] @ Poses.exp((factor[which] @ draws)[..., 0])

    @cached_property
    def shown(self) -> Poses:
        """The cloud that messages, recordings and reports show: 300 poses."""
        return self.cloud(SHOWN_PARTICLES)

    def plot(
        self,
        axes: Axes | None = None,
        *,
        plane: str | None = None,
        truth: Poses | None = None,
        probability: float = 0.9,
    ) -> Axes:
        """Draw the modes from above, with their regions, directions of view and weights, and the particles.

        Args:
            axes: Matplotlib's axes to draw in, where `axes.legend()` adds a legend; None for a new figure with one.
            plane: Two axes of the world, such as "xz"; None for the horizontal ones, by the cameras.
            truth: The true pose, or a true path (n,).
            probability: Of the regions, if their modes are right.

        Raises:
            VaporTrackError: the plane is none, or the probability is not between 0 and 1.
        """
        from filtering.plots import Plan  # which is seldom needed

        plan = Plan(axes, plane, Poses.stack([mode.world_from_camera for mode in self.modes]))
        plan.points(self.particles, "particles")
        plan.modes(self.modes, probability, "mode")
        if truth is not None:
            plan.truth(truth)
        return plan.finish(f"{self.status}: best mode {100 * self.modes[0].weight:.0f} %")


def describe_modes(
    belief: Hypotheses, noise: MeasurementNoise, config: ModeConfig, *, calibrated: bool = False
) -> tuple[Mode, ...]:
    """The modes of a belief, by falling weight; at least one.

    The heaviest hypothesis takes those in its reach, then the heaviest of the rest, and so on. Mean and covariance are
    over a mode's own hypotheses only, with the constant errors added.

    Args:
        belief: n hypotheses.
        noise: Of the first camera.
        config: Which hypotheses make one mode.
        calibrated: Whether the images have Student t tails, see `PosePosterior.calibrated`.
    """
    weights, covariances = belief.weights, belief.pose_covariance
    reach = config.reach(noise, covariances)
    free = (-weights).argsort(kind="stable")
    least = min(config.min_weight, float(weights[free[0]]))
    found: list[Int64[np.ndarray, " m"]] = []  # the hypotheses of each mode, the heaviest first
    offsets: list[Float64[np.ndarray, "m 6"]] = []  # of each from the heaviest
    while len(free) and weights[free].sum() >= least and len(found) < 2 * config.max_modes:
        own, offset = _in_place_of_first(belief.poses, free, reach[free[0]])
        found.append(free[own])
        offsets.append(offset)
        free = np.delete(free, own)
    members, starts = np.concatenate(found), np.cumsum([0, *map(len, found[:-1])])
    totals, means, covariances = mixture_moments(
        weights[members], np.concatenate(offsets), covariances[members], starts
    )
    poses = belief.poses[members[starts]] @ Poses.exp(means)
    nu = _degrees_of_freedom(covariances, noise) if calibrated else np.full(len(poses), np.inf)
    covariances = covariances + noise.constant_covariance(covariances)
    modes = [
        Mode(poses[k], covariances[k], weight, degrees_of_freedom=float(nu[k]))
        for k, weight in enumerate(totals.tolist())
    ]
    modes.sort(key=lambda mode: -mode.weight)
    kept = [mode for mode in modes if mode.weight >= least]
    return tuple((kept or modes[:1])[: config.max_modes])


def _degrees_of_freedom(
    covariances: Float64[np.ndarray, "k 6 6"], noise: MeasurementNoise
) -> Float64[np.ndarray, " k"]:
    """Of modes with these covariances (without constant errors): ν N², if they are worth N ≥ 1 ordinary images.

    N is the information of a mode in that of one image, averaged over the axes. Errors of many images add up to a
    Gaussian; N² fits draws from the filter's own model (`tests/filtering/test_regions.py`). Repeated images of one view
    add to neither.
    """
    finest = noise.finest
    variance_of_image = np.square(finest.typical_std)
    information = np.linalg.inv(covariances)
    images = np.einsum("kii,i->k", information, variance_of_image) / 6.0
    return min(noise.degrees_of_freedom, finest.degrees_of_freedom) * np.square(np.maximum(images, 1.0))


def _in_place_of_first(
    poses: Poses, free: Int64[np.ndarray, " n"], reach: Float64[np.ndarray, " 6"]
) -> tuple[Int64[np.ndarray, " m"], Float64[np.ndarray, "m 6"]]:
    """Which of the free poses are in the place of the first one, itself included, and where there each of these is."""
    first, at = poses[free[0]], poses.translation[free]
    away = at - first.translation
    near = (np.vecdot(away, away) < _MARGIN * max(reach[:3]) ** 2).nonzero()[0]  # `log` is never shorter
    offset = first.between(poses[free[near]]).log()
    within = _within(offset, reach)
    within[0] = True
    return near[within], offset[within]


def _within(offset: Float64[np.ndarray, "*n 6"], reach: Float64[np.ndarray, " 6"]) -> Bool[np.ndarray, "*n"]:
    away = offset / reach
    metres, radians = away[..., :3], away[..., 3:]
    return np.asarray((np.vecdot(metres, metres) <= 1.0) & (np.vecdot(radians, radians) <= 1.0))


def posterior_modes(posterior: PosePosterior) -> tuple[Mode, ...]:
    """The places of one image's posterior, by falling weight; none of an image without any."""
    order = np.argsort(-posterior.weights, kind="stable")
    total = max(float(posterior.weights.sum()), 1e-300)
    verified = np.zeros(len(order), bool) if posterior.verified is None else posterior.verified
    nu = np.where(verified, posterior.noise.finest.degrees_of_freedom, posterior.noise.degrees_of_freedom)
    return tuple(
        Mode(
            posterior.means[k],
            posterior.covariances[k],
            float(posterior.weights[k]) / total,
            bool(verified[k]),
            degrees_of_freedom=float(nu[k]) if posterior.calibrated else np.inf,
        )
        for k in order
    )
