"""Densities and weights against brute-force integration over R³ × SO(3): one measure, and no bias from injection."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import qmc

from filtering.density import KernelDensity
from filtering.motion import Odometry
from filtering.particles import Particles
from filtering.posterior import LikelihoodModel, PosteriorSamples
from filtering.proposal import mixture_log_weights, propose
from filtering.regularisation import KernelConfig
from filtering.sample_size import SampleSizeConfig
from filtering.se3 import Poses

HALF_M = 2.4
VOLUME = (2 * HALF_M) ** 3 * 8 * np.pi**2


def low_discrepancy_poses(num_poses):
    """Sobol points over a box of translations and, by Shoemake's map (1992), over all rotations."""
    u = qmc.Sobol(6, rng=np.random.default_rng(0)).random(num_poses)
    root, turns = np.sqrt(np.stack([1 - u[:, 3], u[:, 3]])), 2 * np.pi * u[:, 4:].T
    quat = np.stack([root[0] * np.sin(turns[0]), root[0] * np.cos(turns[0]),
                     root[1] * np.sin(turns[1]), root[1] * np.cos(turns[1])], axis=1)  # fmt: skip
    return Poses(Rotation.from_quat(quat).as_matrix(), HALF_M * (2 * u[:, :3] - 1))


GRID = low_discrepancy_poses(2**18)


def integral(values):
    """Over the box and all rotations, of a function's values at GRID."""
    return VOLUME * values.mean()


def places(*tangents):
    return Poses.exp(np.array(tangents))


LEFT, RIGHT = [-0.8, 0.2, 0, 0, 0, 0.3], [0.7, 0, 0.3, 0.5, 0, 0]
PRIOR = KernelDensity(places([0.0, 0, 0, 0, 0, 0], [0.5, 0.3, -0.2, 0, 1.0, 0]), 0.6, 1.0)
IMAGE = KernelDensity(places(LEFT, RIGHT, [0.0, 0.5, 0, 0, 0.6, 0]), 0.45, 0.8)


def belief(share_left):
    """Two hypotheses, of 4 and 2 particles of equal weight within each."""
    poses = places(*[np.add(LEFT, [0.1 * k, 0, 0, 0, 0, 0]) for k in range(4)], RIGHT, np.add(RIGHT, 0.1))
    weights = np.repeat([share_left / 4, (1 - share_left) / 2], [4, 2])
    return Particles(poses, np.log(weights)), np.repeat([0, 1], [4, 2])


MOTION = Odometry(Poses.exp(np.array([0.1, 0, 0.1, 0, 0, 0.2])), np.diag([0.4**2] * 3 + [0.7**2] * 3))
CONFIG = KernelConfig(max_kernels=6, share_exponent=1.0, smoothing=0.0, jitter_m=0.0, jitter_rad=0.0)


def proposed(posterior, injection_fraction, num_particles, seed=0, share_left=4 / 6, kernels=CONFIG):
    return propose(
        *belief(share_left), MOTION, posterior, 
        sample_size=SampleSizeConfig(min_particles=num_particles, max_particles=num_particles),
        injection_fraction=injection_fraction,
        kernels=kernels, rng=np.random.default_rng(seed),
    )  # fmt: skip


@dataclass(frozen=True)
class OverTheGrid:
    """A posterior that is the same everywhere and draws the grid: it has p⁻ evaluated there."""

    def sample(self, num_samples, *, rng):
        return GRID[np.arange(num_samples)]

    def log_density(self, poses):
        return np.full(len(poses), -np.log(VOLUME))

    log_likelihood = log_density


def test_posterior_prior_and_prediction_integrate_to_one_in_the_same_measure():
    floor = 1e-3
    unfloored = PosteriorSamples(IMAGE, LikelihoodModel(PRIOR, prior_floor=1e-30))
    assert integral(np.exp(unfloored.log_density(GRID))) == pytest.approx(1.0, abs=0.02)
    prior = np.exp(unfloored.likelihood.log_prior(GRID))
    assert integral(prior) == pytest.approx(1.0, abs=0.02)
    floored = np.exp(LikelihoodModel(PRIOR, prior_floor=floor).log_prior(GRID))
    assert 0.2 < np.mean(prior < floor) < 0.99  # the floor adds what is missing below it, and nothing else
    assert integral(floored) == pytest.approx(1.0 + integral(np.maximum(floor - prior, 0.0)), abs=0.02)
    proposal = proposed(OverTheGrid(), 0.99, 2**18)
    of_the_grid = slice(proposal.num_from_motion, None)
    assert integral(np.exp(proposal.log_predicted[of_the_grid])) == pytest.approx(1.0, abs=0.02)
    assert integral(np.exp(proposal.log_moved[of_the_grid])) == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("temper", [1.0, 0.3])
def test_expectations_under_the_mixture_weights_are_those_of_the_target_whatever_the_injected_fraction(temper):
    """The target is (1 − κ) L p⁻ / ∫ L p⁻ + κ p̂, integrated by brute force; p⁻ is written down afresh."""
    posterior = PosteriorSamples(IMAGE, LikelihoodModel(PRIOR, 0.05, temper, 1e-3))
    moved = KernelDensity(belief(4 / 6)[0].poses @ MOTION.previous_from_current, 0.4, 0.7)
    likelihood = np.exp(posterior.log_likelihood(GRID))
    carried = likelihood * np.exp(moved.log_density(GRID))
    for kidnap_probability in (0.0, 0.2):
        target = (1 - kidnap_probability) * carried / integral(carried)
        target += kidnap_probability * np.exp(posterior.log_density(GRID))
        exact = [integral(target), *(target @ GRID.translation / target.sum())]
        for fraction in (0.1, 0.5, 0.9):
            proposal = proposed(posterior, fraction, 20_000)
            log_likelihood = posterior.log_likelihood(proposal.poses)
            log_weights = mixture_log_weights(proposal, log_likelihood, kidnap_probability=kidnap_probability)
            weights, n = np.exp(log_weights), len(log_weights)
            evidence = np.exp(proposal.log_evidence(log_likelihood))
            assert evidence == pytest.approx(integral(carried), rel=0.05)
            # The evidence is estimated from the motion particles alone: where these are few, the total has its error.
            assert weights.mean() == pytest.approx(exact[0], abs=4 * weights.std() / np.sqrt(n) + 0.03)
            mean = weights @ proposal.poses.translation / weights.sum()
            deviation = weights[:, None] * (proposal.poses.translation - mean) / weights.mean()
            error = deviation.std(axis=0) / np.sqrt(n)
            assert (error < 0.02).all()
            assert (np.abs(mean - exact[1:]) < 4 * error + 0.01).all()  # a hundredth for the grid


def shares_left(fraction, *, exact):
    """Weight of the left hypothesis after an image, over seeds; `exact` or with injected particles counted as drawn."""
    sums = []
    posterior = PosteriorSamples(KernelDensity(places(LEFT, RIGHT) @ MOTION.previous_from_current, 0.6, 0.8))
    for seed in range(8):
        proposal = proposed(posterior, fraction, 4000, seed, 0.8, replace(CONFIG, max_kernels=120))
        log_likelihood = posterior.log_likelihood(proposal.poses)
        if exact:
            log_weights = mixture_log_weights(proposal, log_likelihood, kidnap_probability=0.0)
        else:
            with np.errstate(invalid="ignore"):  # both are nothing where no belief is
                log_weights = log_likelihood + proposal.log_predicted - proposal.log_moved
            log_weights[proposal.num_from_motion :] = log_likelihood[proposal.num_from_motion :]
        weights = np.exp(log_weights)
        function = np.tanh(4 * proposal.poses.translation[:, 0])  # −1 on the left, 1 on the right
        sums.append(0.5 - 0.5 * weights @ function / weights.sum())
    return np.mean(sums), np.std(sums, ddof=1) / np.sqrt(len(sums))


def test_injection_moves_no_weight_between_modes_where_counting_injected_particles_as_drawn_does():
    without, error = shares_left(0.0, exact=True)
    for fraction in (0.1, 0.5):
        share, error_of_share = shares_left(fraction, exact=True)
        assert share == pytest.approx(without, abs=4 * np.hypot(error, error_of_share))
        naive, error_of_naive = shares_left(fraction, exact=False)
        assert naive < without - 4 * np.hypot(error, error_of_naive)
