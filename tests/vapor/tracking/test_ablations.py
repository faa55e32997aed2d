"""The filter without one of its parts still runs, and lacks that part."""

import numpy as np
import pytest

from filtering.config import LocalizerConfig
from filtering.localizer import ParticleLocalizer
from filtering.motion import Odometry
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from tests.helpers.simulation import ERRORS
from vapor.tracking.ablations import ABLATIONS


def poses_around(x_m: float, count: int, seed: int) -> Poses:
    tangent = 0.1 * np.random.default_rng(seed).standard_normal((count, 6))
    tangent[:, 0] += x_m
    return Poses.exp(tangent)


@pytest.mark.parametrize("name", ABLATIONS)
def test_every_ablation_follows_a_camera(name):
    ablation = ABLATIONS[name]
    localizer = ParticleLocalizer(None, ablation.localizer(LocalizerConfig()), rng=np.random.default_rng(0))
    onward = Odometry(Poses.exp(np.array([0.1, 0, 0, 0, 0, 0])), 1e-4 * np.eye(6), 0.1)
    for i in range(8):
        posterior = PosePosterior.from_samples(poses_around(0.1 * i, 100, 10 + i), ablation.noise(ERRORS))
        estimate = localizer.update(posterior, onward)
    assert np.linalg.norm(estimate.modes[0].world_from_camera.translation - [0.7, 0, 0]) < 0.1
    assert np.isfinite(estimate.log_weights).all()


def test_each_ablation_changes_one_thing_and_full_nothing():
    config = LocalizerConfig()
    changed = {
        name: (
            ablation.localizer(config) != config,
            ablation.noise(ERRORS) != ERRORS,
            ablation.known_kidnap,
        )
        for name, ablation in ABLATIONS.items()
    }
    assert changed["full"] == (False, False, False)
    assert all(sum(change) == 1 for name, change in changed.items() if name != "full")


def test_without_correlated_errors_every_image_is_new_however_little_the_camera_moves():
    noise = ABLATIONS["no-correlation"].noise(ERRORS)
    assert noise.correlated_fraction == 0.0
    novelty = {}
    for name, of_ablation in (("full", ERRORS), ("no-correlation", noise)):
        localizer = ParticleLocalizer(None, rng=np.random.default_rng(0))
        hardly = Odometry(Poses.exp(np.array([0.01, 0, 0, 0, 0, 0])), 1e-6 * np.eye(6), 0.1)
        for i in range(3):
            estimate = localizer.update(PosePosterior.from_samples(poses_around(0.0, 100, i), of_ablation), hardly)
        novelty[name] = estimate.novelty
    assert novelty["full"] < 0.05
    assert novelty["no-correlation"] == 1.0


def test_without_injection_nothing_is_born_where_images_move_to():
    weights = {}
    for name in ("full", "no-injection"):
        config = ABLATIONS[name].localizer(LocalizerConfig(birth_rate=0.1))
        localizer = ParticleLocalizer(None, config, rng=np.random.default_rng(0))
        onward = Odometry(Poses.exp(np.array([0.6, 0, 0, 0, 0, 0])), 1e-4 * np.eye(6), 0.5)
        for i in range(8):
            x_m = 0.6 * i + (0.0 if i < 3 else 9.0)
            posterior = PosePosterior.from_samples(poses_around(x_m, 100, i), ERRORS)
            estimate = localizer.update(posterior, onward)
        at = estimate.modes[0].world_from_camera.translation[0]
        weights[name] = abs(at - x_m) < 0.3
    assert weights == {"full": True, "no-injection": False}
