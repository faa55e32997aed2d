"""Rao-Blackwellised particles: each is a hypothesis with a Gaussian over its pose, odometry bias and correlated errors.

Sources: Doucet, de Freitas, Murphy and Russell, "Rao-Blackwellised particle filtering for dynamic Bayesian networks",
2000; Solà, Deray and Atchuthan, "A micro Lie theory for state estimation in robotics", 2018 (error states on SE(3)).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float64, Int64

from filtering.errors import VaporTrackError
from filtering.motion import OdometryBias
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from filtering.unchecked import unchecked_replace

POSE, BIAS, DRIFT = slice(0, 6), slice(6, 13), slice(7, 13)
"""Parts of a state: the error of the pose, and odometry bias (scale, and drift of each axis)."""

RIGHT, BIASED, USELESS = range(3)
"""Regimes of odometry: it errs as stated; it is off by a motion of its own, as where wheels slip; it says nothing.

The drift of a hypothesis is that motion where odometry is biased, and the camera's velocity where it is useless."""

_BLOCK = 256


def correlated_error(source: int) -> slice:
    """The part of a state with the correlated error of a source of places, in units of the error's square root."""
    return slice(13 + 6 * source, 19 + 6 * source)


def along_map(
    factors: Float64[np.ndarray, "n 6 6"], rotations: Float64[np.ndarray, "n 3 3"]
) -> Float64[np.ndarray, "n 6 6"]:
    """Factors of correlated errors of which the position is along the axes of the map, and the rotation about those of
    the camera: where a network takes a place for a bit too high, it does so whatever way the camera looks.

    Args:
        factors: Square roots of covariances in the tangent at a pose.
        rotations: Of each pose, from the camera to the map.
    """
    along = factors.copy()
    along[:, :, :3] = factors[:, :, :3] @ np.swapaxes(rotations, 1, 2)
    return along


def blocks(count: int) -> Iterator[slice]:
    """Blocks of hypotheses whose covariances fit into a processor's cache."""
    return (slice(start, start + _BLOCK) for start in range(0, count, _BLOCK))


def log_sum(log_values: Float64[np.ndarray, " n"]) -> float:
    """Log of the sum of exp(values) (n,), n ≥ 1."""
    largest = float(log_values.max())
    if not math.isfinite(largest):
        return largest
    return largest + math.log(np.exp(log_values - largest).sum())


@dataclass(frozen=True)
class Hypotheses:
    """n hypotheses. A state is the error of the pose (6), odometry bias (7), and of each source the bias (6).

    Attributes:
        poses: world_from_camera, batch (n,). The true pose is `poses @ exp(ξ)`, ξ the error of the pose, of mean 0.
        mean: Mean of the other parts of the state, (n, d − 6).
        covariance: Of the state, (n, d, d).
        log_weights: Log weights, normalised, (n,).
        regime: Of the odometry, (n,): `RIGHT`, `BIASED` or `USELESS`.
    """

    poses: Poses
    mean: Float64[np.ndarray, "n m"]
    covariance: Float64[np.ndarray, "n d d"]
    log_weights: Float64[np.ndarray, " n"]
    regime: Int64[np.ndarray, " n"]

    def __len__(self) -> int:
        return len(self.log_weights)

    def __getitem__(self, index: slice | Int64[np.ndarray, " k"] | np.ndarray) -> Hypotheses:
        return Hypotheses(
            self.poses[index],
            self.mean[index],
            self.covariance[index],
            self.log_weights[index],
            self.regime[index],
        )

    @property
    def weights(self) -> Float64[np.ndarray, " n"]:
        """Normalised weights, (n,)."""
        return np.exp(self.log_weights)

    @cached_property
    def variances(self) -> tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, " n"]]:
        """Of the pose, all axes together, m² and rad², (n,) each."""
        position, rotation = (np.einsum("nii->n", self.covariance[:, part, part]) for part in (slice(3), slice(3, 6)))
        return position, rotation

    @property
    def pose_covariance(self) -> Float64[np.ndarray, "n 6 6"]:
        """Of ξ = (v, ω), metres and radians, in the tangent at each pose."""
        return self.covariance[:, POSE, POSE]

    def with_log_weights(self, log_weights: Float64[np.ndarray, " n"]) -> Hypotheses:
        """The same with other weights (n,), which need not be normalised.

        Raises:
            VaporTrackError: a weight is NaN or +∞, or all are zero.
        """
        total = log_sum(log_weights)
        if total == -np.inf:
            raise VaporTrackError(f"all {len(log_weights)} weights are zero, expected at least one positive")
        if not np.isfinite(total):
            bad = np.isnan(log_weights) | (log_weights == np.inf)
            first = int(np.argmax(bad))
            raise VaporTrackError(
                f"log weight of hypothesis {first} is {log_weights[first]}, expected a finite number or −∞ "
                f"({int(bad.sum())} of {len(bad)} are so)"
            )
        return unchecked_replace(self, log_weights=log_weights - total)

    def reweighted(self, log_factors: Float64[np.ndarray, " n"] | float) -> Hypotheses:
        """The same with weights times factors, of all or of each (n,), not normalised."""
        return unchecked_replace(self, log_weights=self.log_weights + log_factors)

    def normalized(self) -> Hypotheses:
        """The same with normalised weights, see `with_log_weights`."""
        return self.with_log_weights(self.log_weights)


def concatenate(parts: Sequence[Hypotheses]) -> Hypotheses:
    """Join hypotheses along their first axis; the weights stay as they are."""
    return Hypotheses(
        Poses.concatenate([part.poses for part in parts]),
        np.concatenate([part.mean for part in parts]),
        np.concatenate([part.covariance for part in parts]),
        np.concatenate([part.log_weights for part in parts]),
        np.concatenate([part.regime for part in parts]),
    )


def birth(
    posterior: PosePosterior,
    camera: int,
    num_sources: int,
    odometry_bias: OdometryBias,
    belief: Hypotheses | None,
    landmarks: int | None = None,
) -> Hypotheses:
    """A hypothesis for each place of a posterior, weighted by its share.

    The odometry bias is that of the belief (`odometry_bias_of`), if there is one: it does not depend on the place.

    Args:
        posterior: Of an image.
        camera: The number of the correlated error of the camera that took it.
        num_sources: How many correlated errors a state has.
        odometry_bias: Of the odometry.
        belief: Present hypotheses; None where there are none.
        landmarks: The number of the correlated error of verified places; None where there are none.
    """
    count, size = len(posterior.weights), 13 + 6 * num_sources
    covariance = np.zeros((count, size, size))
    mean = np.zeros((count, size - 6))
    diagonal = np.arange(6, size)
    covariance[:, diagonal, diagonal] = 1.0
    covariance[:, 6, 6] = odometry_bias.scale**2
    if belief is not None:
        mean[:, :7], covariance[:, BIAS, BIAS] = odometry_bias_of(belief)
    covariance[:, POSE, POSE] = posterior.covariances
    for source, number in enumerate((camera, camera if landmarks is None else landmarks)):
        places, own = posterior.sources[source], correlated_error(number)
        if len(places) == 0:
            continue
        factors = along_map(posterior.factors[places], posterior.means.rotation[places])
        shared = -np.sqrt(posterior.noise_of(source).correlated_fraction) * factors
        covariance[places, POSE, own] = shared
        covariance[places, own, POSE] = np.swapaxes(shared, 1, 2)
    shares = posterior.shares
    places = shares.nonzero()[0]
    born = Hypotheses(posterior.means, mean, covariance, np.zeros(count), np.full(count, RIGHT))
    return born[places].with_log_weights(np.log(shares[places]))


def odometry_bias_of(belief: Hypotheses) -> tuple[Float64[np.ndarray, " 7"], Float64[np.ndarray, "7 7"]]:
    """Mean and covariance of the odometry bias, by the heaviest hypothesis for which odometry is right.

    Where it is right for none, the scale error is that of the heaviest one, and the drift is unknown.
    """
    right = (belief.regime == RIGHT).nonzero()[0]
    if len(right):
        heaviest = right[belief.log_weights[right].argmax()]
        return belief.mean[heaviest, :7], belief.covariance[heaviest, BIAS, BIAS]
    heaviest = belief.log_weights.argmax()
    mean, covariance = np.zeros(7), np.eye(7)
    mean[0], covariance[0, 0] = belief.mean[heaviest, 0], belief.covariance[heaviest, BIAS.start, BIAS.start]
    return mean, covariance


def with_drift(
    hypotheses: Hypotheses, mean: Float64[np.ndarray, " 6"], covariance: Float64[np.ndarray, "6 6"]
) -> Hypotheses:
    """The same with another drift, which is not correlated with the rest of the state."""
    after = unchecked_replace(hypotheses, mean=hypotheses.mean.copy(), covariance=hypotheses.covariance.copy())
    set_drift(after, mean, covariance)
    return after


def set_drift(
    hypotheses: Hypotheses, mean: Float64[np.ndarray, " 6"] | float, covariance: Float64[np.ndarray, "6 6"]
) -> None:
    """As `with_drift`, in place."""
    hypotheses.mean[:, DRIFT.start - 6 : DRIFT.stop - 6] = mean
    hypotheses.covariance[:, DRIFT] = hypotheses.covariance[:, :, DRIFT] = 0.0
    hypotheses.covariance[:, DRIFT, DRIFT] = covariance


def without_correlation(covariance: Float64[np.ndarray, "n d d"], camera: int) -> Float64[np.ndarray, "n d d"]:
    """Covariances of states whose poses are not correlated with the errors of a camera."""
    apart = covariance.copy()
    apart[:, POSE, correlated_error(camera)] = apart[:, correlated_error(camera), POSE] = 0.0
    return apart


def with_source(hypotheses: Hypotheses) -> Hypotheses:
    """The same with the correlated error of one more source, which is unknown, at the end of the state."""
    count, size = hypotheses.covariance.shape[:2]
    covariance = np.zeros((count, size + 6, size + 6))
    covariance[:, :size, :size] = hypotheses.covariance
    covariance[:, range(size, size + 6), range(size, size + 6)] = 1.0
    mean = np.concatenate([hypotheses.mean, np.zeros((count, 6))], axis=1)
    return unchecked_replace(hypotheses, mean=mean, covariance=covariance)
