"""The filter without one of its parts still runs, and lacks that part."""

import numpy as np
import pytest

from filtering.localizer import LocalizerConfig, ParticleLocalizer
from filtering.motion import Odometry
from filtering.proposal import Proposal
from filtering.se3 import Poses
from vapor.checkpoint import Calibration
from vapor.variants import VARIANTS

CALIBRATION = Calibration()


def poses_around(x_m: float, count: int, seed: int) -> Poses:
    tangent = 0.1 * np.random.default_rng(seed).standard_normal((count, 6))
    tangent[:, 0] += x_m
    return Poses.exp(tangent)


PRIOR = Poses.concatenate([poses_around(0.0, 300, 0), poses_around(6.0, 20, 1)])


@pytest.mark.parametrize("name", VARIANTS)
def test_every_variant_follows_a_camera_that_stands_still(name):
    variant = VARIANTS[name]
    likelihood = variant.likelihood(CALIBRATION.likelihood(PRIOR), PRIOR)
    config = variant.localizer(LocalizerConfig(num_particles=200))
    localizer = ParticleLocalizer(None, config, rng=np.random.default_rng(0))
    still = Odometry(Poses.identity(), 1e-4 * np.eye(6))
    for i in range(8):
        posterior = CALIBRATION.posterior(poses_around(0.0, 100, 10 + i), likelihood)
        estimate = localizer.update(posterior, still)
    assert np.linalg.norm(estimate.modes[0].world_from_camera.translation) < 0.1
    assert np.isfinite(estimate.log_weights).all() or name in ("no-tempering", "no-recovery", "no-injection")


def test_a_flat_prior_is_as_high_as_the_true_one_is_on_average_where_cameras_are():
    likelihood = CALIBRATION.likelihood(PRIOR)
    flat = VARIANTS["no-prior"].likelihood(likelihood, PRIOR)
    seldom, often = PRIOR[300:], PRIOR[:300]
    assert np.ptp(flat.log_prior(PRIOR)) == 0.0
    assert likelihood.log_prior(seldom).mean() < flat.log_prior(seldom).mean()
    assert likelihood.log_prior(often).mean() > flat.log_prior(often).mean()
    assert flat.log_prior(PRIOR).mean() == pytest.approx(likelihood.log_prior(PRIOR).mean())


def test_each_variant_changes_what_it_says_and_nothing_else():
    config, likelihood = LocalizerConfig(), CALIBRATION.likelihood(PRIOR)
    changed = {
        name: (
            variant.kind is not ParticleLocalizer,
            variant.localizer(config) != config,
            variant.likelihood(likelihood, PRIOR) is not likelihood,
            variant.told_of_kidnap,
        )
        for name, variant in VARIANTS.items()
    }
    assert changed["full"] == (False, False, False, False)
    assert all(sum(change) == 1 for name, change in changed.items() if name != "full")
    assert VARIANTS["no-tempering"].likelihood(likelihood, PRIOR).temper == 1.0
    unsaturated = VARIANTS["no-saturation"].likelihood(likelihood, PRIOR)
    assert (unsaturated.saturation, unsaturated.temper) == (np.inf, 0.1)
    assert VARIANTS["fixed-size"].localizer(config).num_particles == 1000
    assert VARIANTS["no-injection"].localizer(config).injection_fraction == 0.0
    assert VARIANTS["no-recovery"].localizer(config).recovery.max_kidnap_probability == 0.0


def test_equal_injected_weights_are_the_mean_of_the_others():
    poses = poses_around(0.0, 4, 0)
    proposal = Proposal(
        poses, 3, np.array([*np.log([0.1, 0.2, 0.3]), -np.inf]), np.array([0, 0, 0, -np.inf]), np.zeros(4)
    )
    localizer = VARIANTS["equal-injected-weights"].kind(None, rng=np.random.default_rng(0))
    weights = np.exp(localizer._weigh(proposal, np.zeros(4)))
    np.testing.assert_allclose(weights, [0.1, 0.2, 0.3, 0.2])
