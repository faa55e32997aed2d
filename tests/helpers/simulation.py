"""Simulated walks with posteriors whose errors follow the measurement noise: the filter without a network."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from filtering.association import Correlation, correct, evidence, gate
from filtering.config import LocalizerConfig
from filtering.hypotheses import Hypotheses
from filtering.localizer import ParticleLocalizer
from filtering.measurement_noise import MeasurementNoise
from filtering.motion import Odometry
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from sequences.frame import Frame

FLOOR_HEIGHT_M = 3.0
ODOMETRY_STD = np.array([0.005] * 3 + [0.003] * 3)
POSTERIOR_STD = np.array([0.15] * 3 + [0.1] * 3)
ERRORS = MeasurementNoise()
STD = np.array([0.1, 0.1, 0.1, 0.05, 0.05, 0.05])


def motion(*tangent, std=ODOMETRY_STD, duration_s=0.1):
    """Odometry of a motion ξ with independent noise of each axis."""
    return Odometry(Poses.exp(np.array(tangent, np.float64)), np.diag(np.square(std)), duration_s)


def lifted(pose, heights_m):
    """The same pose at several heights above it, batch (k,)."""
    lift = np.asarray(heights_m, np.float64)[:, None] * np.array([0.0, 0, 1])
    return Poses(np.repeat(pose.rotation[None], len(lift), 0), pose.translation + lift)


def seen_at(means, shares=(1.0,), *, std=STD, noise=ERRORS, ood_score=0.0):
    """The posterior whose places are at these poses (k,), each with the same standard deviations."""
    means = Poses(means.rotation.reshape(-1, 3, 3), means.translation.reshape(-1, 3))
    covariances = np.repeat(np.diag(np.square(std))[None], len(means), 0)
    return PosePosterior(means, covariances, np.array(shares, np.float64), noise, means, ood_score)


def wandering(distances, size, *, rng):
    """An Ornstein-Uhlenbeck process (n, size) of unit variance along a distance, n − 1 steps apart."""
    values = [rng.standard_normal(size)]
    for distance in distances:
        kept = np.exp(-distance)
        values.append(kept * values[-1] + np.sqrt(1.0 - kept**2) * rng.standard_normal(size))
    return np.array(values)


def image_errors(distances, noise, *, std=STD, rng):
    """Errors ξ (n, 6) of images at normalized distances from the one before: correlated and fresh ones."""
    correlated = wandering(distances, 6, rng=rng)
    fresh = rng.standard_normal((len(distances) + 1, 6))
    share = noise.correlated_fraction
    return std * (np.sqrt(share) * correlated + np.sqrt(1.0 - share) * fresh)


@dataclass(frozen=True)
class Oracle:
    """An observation model that knows the truth: equal modes on all floors, or the true one where it is unique.

    An image carries only its frame's index, in its first two values.
    """

    truth: Poses
    floors: tuple[int, ...]
    unique: range

    def observe(self, image, *, rng):
        index = int(image[0, 0, 0]) + 256 * int(image[0, 0, 1])
        floors = (0,) if index in self.unique else self.floors
        samples = self.truth[index] @ Poses.exp(rng.standard_normal((500, 6)) * POSTERIOR_STD)
        lift = np.zeros((500, 3))
        lift[:, 2] = FLOOR_HEIGHT_M * rng.choice(floors, 500)
        noise = replace(ERRORS, radius_m=1.0, radius_rad=0.8)
        return PosePosterior.from_samples(Poses(samples.rotation, samples.translation + lift), noise)


def image_of(index):
    image = np.zeros((2, 2, 3), np.uint8)
    image[0, 0, :2] = index % 256, index // 256
    return image


def climb(num_frames, *, rng):
    """True poses (n,) of a walk up, and noisy odometry between them (the first None)."""
    truth, odometry = [Poses.exp(np.array([0.0, 0, 6, 0, 0, 0]))], [None]
    for i in range(1, num_frames):
        delta = Poses.exp(np.array([0.08, 0, 0.03, 0, 0, 0.02 * np.sin(i / 10)]))
        truth.append(truth[-1] @ delta)
        measured = delta @ Poses.exp(rng.standard_normal(6) * ODOMETRY_STD)
        odometry.append(Odometry(measured, np.diag(ODOMETRY_STD**2), 0.1))
    return Poses.stack(truth), odometry


RNG = np.random.default_rng

STAY = motion(0, 0, 0, 0, 0, 0)

AHEAD = motion(0.1, 0, 0, 0, 0, 0.02)

OUT_OF_DISTRIBUTION = PosePosterior(Poses.identity(0), np.zeros((0, 6, 6)), np.zeros(0), ERRORS, Poses.identity(0), 3.0)


def new_localizer(seed=0, **settings):
    return ParticleLocalizer(None, LocalizerConfig(**settings), rng=RNG(seed))


def assert_same_belief(one, other, **tolerance):
    np.testing.assert_allclose(one.particles.as_matrix(), other.particles.as_matrix(), **tolerance)
    np.testing.assert_allclose(one.covariances, other.covariances, **tolerance)
    np.testing.assert_allclose(one.log_weights, other.log_weights, **tolerance)


def weight_near(estimate, position, within=1.0):
    near = np.linalg.norm(estimate.particles.translation - np.asarray(position), axis=1) < within
    return float(np.exp(estimate.log_weights)[near].sum())


def walk(localizer, count, *, shares=(1.0,), heights_m=(0.0,), pose=None, seed=0, noise=ERRORS, step=AHEAD):
    """Estimates along a walk whose images err as modelled, and the true pose at its end."""
    rng = RNG(seed)
    pose = Poses.identity() if pose is None else pose
    distance = float(np.hypot(*(np.linalg.norm(part) for part in np.split(step.previous_from_current.log(), 2)))) / 0.45
    estimates = []
    for error in image_errors([distance] * (count - 1), noise, rng=rng):
        pose = pose @ step.previous_from_current
        seen = lifted(pose @ Poses.exp(error), heights_m)
        estimates.append(localizer.update(seen_at(seen, shares, noise=noise), step))
    return estimates, pose


def frames_of(count: int, *, odometry: bool = True, seed: int = 0, step_ns: int = 10**8) -> list[Frame]:
    rng = np.random.default_rng(seed)
    truth, increments = climb(count, rng=rng)
    images = rng.integers(0, 256, (count, 36, 36, 3), dtype=np.uint8)
    return [Frame(i * step_ns, images[i], increments[i] if odometry else None, truth[i]) for i in range(count)]


def translated(points) -> Poses:
    return Poses(np.tile(np.eye(3), (len(points), 1, 1)), np.array(points))


class Associated(NamedTuple):
    """The hypotheses after an image, with weights not normalised, and its log evidence for each before it, (n,)."""

    hypotheses: Hypotheses
    log_evidence: np.ndarray
    agreement: float


def associate(
    belief: Hypotheses, posterior: PosePosterior, camera: int, *, novelty: float, distance: float
) -> Associated:
    """Weigh and correct a belief by an image of a camera at a distance from its last one."""
    pairs = gate(belief, posterior, [Correlation(camera, distance)])
    found = evidence(belief, posterior, pairs, LocalizerConfig().outlier_places)
    after = correct(belief.reweighted(novelty * found.log_likelihood), posterior, pairs, found.outlier)
    return Associated(after, found.log_likelihood, found.agreement)
