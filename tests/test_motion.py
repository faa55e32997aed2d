from dataclasses import replace

import numpy as np
import pytest

from filtering.density import KernelDensity
from filtering.errors import VaporTrackError
from filtering.motion import MotionNoise, Odometry, covariance_factor, isotropic_std
from filtering.particles import Particles
from filtering.posterior import PosteriorSamples
from filtering.proposal import mixture_log_weights, propose
from filtering.regularisation import KernelConfig
from filtering.sample_size import SampleSizeConfig
from filtering.se3 import Poses


def belief(poses):
    return Particles.from_unnormalised(poses, np.zeros(len(poses)))[0]


def fixed(num_particles):
    return SampleSizeConfig(min_particles=num_particles, max_particles=num_particles)


STILL = KernelConfig(jitter_m=0.0, jitter_rad=0.0)


def draw(odometry, n=20_000, injection_fraction=0.0, seed=0, **changes):
    posterior = PosteriorSamples(KernelDensity(Poses.exp(np.array([[5.0, 0, 0, 0, 0, 0]])), 0.1, 0.1))
    start = Poses.exp(np.tile([1.0, 2, 3, 0.1, 0.2, 0.3], (10, 1)))
    return start[0], propose(
        belief(start),
        np.zeros(10, np.int64),
        odometry,
        posterior,
        sample_size=fixed(n),
        injection_fraction=injection_fraction,
        kernels=replace(STILL, **changes),
        rng=np.random.default_rng(seed),
    )


def test_particles_follow_the_odometry_in_their_own_frame_with_its_noise():
    delta = Poses.exp(np.array([0.5, 0.0, 0.1, 0.0, 0.3, 0.0]))
    covariance = np.diag([0.04**2] * 3 + [0.02**2] * 3)
    start, proposal = draw(Odometry(delta, covariance))
    error = ((start @ delta).inverse() @ proposal.poses).log()
    np.testing.assert_allclose(error.mean(axis=0), 0.0, atol=4 * 0.04 / np.sqrt(20_000))
    np.testing.assert_allclose(error.std(axis=0), [0.04] * 3 + [0.02] * 3, rtol=0.03)


def test_the_predicted_density_is_the_density_that_the_particles_were_drawn_from():
    """Importance sampling with it integrates a known function right: E over draws of f/p⁻ is the integral of f."""
    _, proposal = draw(Odometry(Poses.identity(), np.diag([0.05**2] * 6)), jitter_m=0.02, jitter_rad=0.02)
    target = KernelDensity(Poses.exp(np.array([[1.0, 2, 3, 0.1, 0.2, 0.3]])), 0.04, 0.04)
    ratio = np.exp(target.log_density(proposal.poses) - proposal.log_predicted)
    assert ratio.mean() == pytest.approx(1.0, abs=4 * ratio.std() / np.sqrt(len(ratio)))
    assert ratio.std() > 0.1  # the two densities do differ


def test_an_unlikely_place_keeps_particles_at_its_true_small_weight():
    weights = np.repeat([0.9999, 0.0001], 100) / 100
    there = np.repeat([0.0, 3.0], 100)[:, None] * np.eye(6)[0]
    unlikely = Particles(Poses.exp(there), np.log(weights))
    image = PosteriorSamples(KernelDensity(Poses.identity(1), 0.1, 0.1))
    proposal = propose(
        unlikely, np.full(200, -1), Odometry(Poses.identity(), 1e-4 * np.eye(6)), image, sample_size=fixed(4000),
        injection_fraction=0.0, kernels=KernelConfig(jitter_m=0.01, jitter_rad=0.01), rng=np.random.default_rng(0),
    )  # fmt: skip
    share = np.exp(proposal.log_predicted - proposal.log_moved)
    at_it = proposal.poses.translation[:, 0] > 1.5
    assert at_it.mean() == pytest.approx(0.01, rel=0.2)  # the root of one in 10 000
    assert share[at_it].sum() / share.sum() == pytest.approx(0.0001, rel=0.2)


def test_the_image_draws_its_fraction():
    _, proposal = draw(Odometry(Poses.identity(), 1e-4 * np.eye(6)), n=1000, injection_fraction=0.1)
    assert proposal.num_from_motion == 900
    assert (np.abs(proposal.poses.translation[900:] - [5.0, 0, 0]) < 0.6).all()


def test_mixture_weights_integrate_the_filtering_target_whatever_the_fraction():
    """Bayes by brute force: L p⁻ / ∫ L p⁻ integrates to one for any φ, and the evidence is ∫ L p⁻."""
    covariance = np.diag([0.05**2] * 6)
    likelihood_centre = Poses.exp(np.array([[1.05, 2, 3, 0.1, 0.2, 0.3]]))
    bump = KernelDensity(likelihood_centre, 0.1, 0.1)
    wide = KernelDensity(likelihood_centre, 0.12, 0.12)
    means, evidence = [], []
    for fraction in (0.0, 0.3, 0.7):
        start = Poses.exp(np.tile([1.0, 2, 3, 0.1, 0.2, 0.3], (10, 1)))
        proposal = propose(
            belief(start), np.zeros(len(start), np.int64), Odometry(Poses.identity(), covariance),
            PosteriorSamples(wide),
            sample_size=fixed(40_000),
            injection_fraction=fraction, kernels=replace(STILL, max_kernels=10), rng=np.random.default_rng(1),
        )  # fmt: skip
        log_weights = mixture_log_weights(
            proposal, bump.log_density(proposal.poses), kidnap_probability=0.0
        )  # fmt: skip
        means.append(np.exp(log_weights).mean())
        evidence.append(np.exp(proposal.log_evidence(bump.log_density(proposal.poses))))
    np.testing.assert_allclose(means, 1.0, rtol=0.05)  # standard errors are near 1 %
    # The integral of two kernels' product, by drawing from one and evaluating the other.
    exact = np.exp(bump.log_density(KernelDensity(start[:1], 0.05, 0.05).sample(200_000, rng=np.random.default_rng(2))))
    np.testing.assert_allclose(evidence, exact.mean(), rtol=0.05)


def test_noise_is_made_isotropic_on_the_safe_side():
    covariance = np.diag([0.1, 0.2, 0.3, 0.01, 0.02, 0.03]) ** 2
    translation_m, rotation_rad = isotropic_std(covariance, (0.4, 0.04))
    assert translation_m == pytest.approx(0.5)
    assert rotation_rad == pytest.approx(0.05)


def test_a_singular_covariance_has_a_factor():
    covariance = np.zeros((6, 6))
    covariance[0, 0] = 4.0
    factor = covariance_factor(covariance)
    np.testing.assert_allclose(factor @ factor.T, covariance, atol=1e-12)


@pytest.mark.parametrize(
    ("covariance", "message"),
    [
        (np.diag([1.0, 1, 1, 1, 1, -0.5]), "negative eigenvalue -0.5"),
        (np.full((6, 6), np.nan), "not finite"),
        (np.eye(6) + np.eye(6, k=1), "not symmetric"),
    ],
)
def test_what_is_no_covariance_is_refused_with_its_value(covariance, message):
    with pytest.raises(VaporTrackError, match=message):
        covariance_factor(covariance)


def test_stated_noise_grows_with_motion_and_time():
    noise = MotionNoise()
    still = noise.covariance(Poses.identity(), 0.1)
    moving = noise.covariance(Poses.exp(np.array([1.0, 0, 0, 0, 0, 0.5])), 0.1)
    later = noise.covariance(Poses.identity(), 1.0)
    assert (np.diag(moving) > np.diag(still)).all()
    np.testing.assert_allclose(np.diag(later), 10 * np.diag(still))


def test_the_kidnapped_share_of_the_belief_is_the_posterior_of_the_image():
    place, elsewhere = Poses.exp(np.array([[1.0, 2, 3, 0.1, 0.2, 0.3]])), Poses.exp(np.array([[4.0, 2, 3, 0, 0, 0.3]]))
    posterior = PosteriorSamples(KernelDensity(elsewhere, 0.1, 0.1))
    proposal = propose(
        belief(place[[0] * 10]), np.zeros(10, np.int64), Odometry(Poses.identity(), np.diag([0.05**2] * 6)), posterior,
        sample_size=fixed(4000),
        injection_fraction=0.3, kernels=replace(STILL, max_kernels=10), rng=np.random.default_rng(3),
    )  # fmt: skip
    log_likelihood = posterior.log_likelihood(proposal.poses)
    for kidnap_probability in (0.0, 1e-4, 0.2, 1.0):
        weights = np.exp(mixture_log_weights(proposal, log_likelihood, kidnap_probability=kidnap_probability))
        there = proposal.poses.translation[:, 0] > 2.5
        assert weights[there].sum() / weights.sum() == pytest.approx(kidnap_probability, rel=0.02, abs=1e-12)
    impossible = np.where(there, 0.0, -np.inf)
    weights = np.exp(mixture_log_weights(proposal, impossible, kidnap_probability=1e-4))
    assert weights[there].sum() == pytest.approx(weights.sum())
    assert not np.exp(mixture_log_weights(proposal, impossible, kidnap_probability=0.0)).any()
