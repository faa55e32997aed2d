"""Odometry that is wrong for five seconds: the belief follows the images that contradict it."""

import numpy as np
import pytest

from filtering.localizer import ParticleLocalizer
from filtering.motion import Odometry
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from tests.helpers.simulation import ERRORS

STD = np.array([0.07] * 3 + [0.04] * 3)
WHITE = np.diag([0.003**2] * 3 + [0.001**2] * 3)
SPEEDS = {"none": (1.0, 1.0), "slip": (0.0, 0.2), "stuck": (1.0, 0.0), "tripled": (1.0, 3.0)}  # true and reported, m/s


def followed(kind, seed):
    """Distances of the best mode in its standard deviations, errors in metres, and statuses, from the fault on."""
    rng, localizer = np.random.default_rng(seed), ParticleLocalizer(None, rng=np.random.default_rng(seed))
    true, shared, found = Poses.identity(), rng.standard_normal(6), []
    for i in range(180):
        wrong = 80 <= i < 130
        speed, reported = SPEEDS[kind] if wrong or kind == "slip" else (1.0, 1.0)
        reported = reported if wrong else speed
        if i:
            true = (
                true
                @ Poses.exp(np.array([0.1 * speed, 0, 0, 0, 0, 0]))
                @ Poses.exp(np.sqrt(np.diag(WHITE)) * rng.standard_normal(6))
            )
            kept = np.exp(-0.1 * speed / ERRORS.length_m)
            shared = kept * shared + np.sqrt(1 - kept**2) * rng.standard_normal(6)
        seen = true @ Poses.exp(STD * (np.sqrt(0.7) * shared + np.sqrt(0.3) * rng.standard_normal(6)))
        odometry = Odometry(Poses.exp(np.array([0.1 * reported, 0, 0, 0, 0, 0])), WHITE, 0.1)
        posterior = PosePosterior.from_estimates(Poses.stack([seen]), 0.07, 0.04, ERRORS)
        best = (estimate := localizer.update(posterior, odometry if i else None)).modes[0]
        error = best.world_from_camera.between(true).log()[:3]
        squared = error @ np.linalg.solve(best.covariance[:3, :3], error)
        if i >= 80:
            found.append((np.sqrt(squared), np.linalg.norm(error), estimate.status == "converged"))
    return (np.array(column) for column in zip(*found, strict=True))


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(("kind", "far", "error_m"), [("none", 0, 0.15), ("slip", 20, 0.45), ("tripled", 5, 1.2)])
def test_images_that_contradict_odometry_win_within_a_second(kind, far, error_m):
    """`far`: images that may be `converged` over four standard deviations off, of 100."""
    distance, error, converged = followed(kind, seed=11)
    assert np.sum(converged & (distance > 4.0)) <= far
    assert error.max() < error_m
    assert np.median(error) < 0.13
    assert converged[-1]


@pytest.mark.usefixtures("unchecked")
def test_wheels_that_are_stuck_do_not_hold_the_belief():
    _, error, converged = followed("stuck", seed=12)
    assert (converged & (error > 0.3)).sum() <= 5
    assert (error[70:] < 0.3).all()
