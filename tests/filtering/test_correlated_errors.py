"""Neighbouring images share their errors: neither waiting nor a higher rate buys confidence, seeing more does."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from filtering.config import LocalizerConfig
from filtering.hypotheses import along_map
from filtering.localizer import ParticleLocalizer
from filtering.motion import Odometry, OdometryBias
from filtering.se3 import Poses
from tests.helpers.simulation import ERRORS, STAY, STD, image_errors, lifted, seen_at, wandering

pytestmark = pytest.mark.usefixtures("unchecked")

RNG = np.random.default_rng
ALIKE = (0.0, 3.0, 6.0)
PIXEL_NOISE = np.array([1e-3] * 3 + [5e-4] * 3)
AT_REST = np.array([1e-4] * 3 + [5e-5] * 3)


def stds_of(mode):
    """Standard deviations without those that no image takes away."""
    return np.sqrt(np.diag(mode.covariance - ERRORS.constant_covariance(np.zeros((6, 6)))))


def weights_of(estimate, heights_m=ALIKE):
    """Shares of the belief at each height."""
    nearest = np.argmin(np.abs(estimate.particles.translation[:, 2:] - np.array(heights_m)), axis=1)
    return np.bincount(nearest, np.exp(estimate.log_weights), len(heights_m))


def stand(localizer, shares, count, *, noise=None, jitter_m=0.0, seed=0, pose=None):
    """Estimates of images of one view; the odometry trembles about one pose, the posterior as its pixels would."""
    rng, estimates, last = RNG(seed), [], np.zeros(6)
    pose = Poses.identity() if pose is None else pose
    heights_m = ALIKE[: len(shares)]
    for _ in range(count):
        seen = pose if noise is None else pose @ Poses.exp(noise * rng.standard_normal(6))
        now = jitter_m * rng.uniform(-1, 1, 6) * np.repeat([1.0, 0.3], 3)
        odometry = Odometry(Poses.exp(-last) @ Poses.exp(now), np.diag(AT_REST**2), 0.1)
        last = now
        estimates.append(localizer.update(seen_at(lifted(seen, heights_m), shares), odometry))
    return estimates


WAYS_TO_STAND = {
    "equal": {},
    "with odometry that trembles": {"noise": PIXEL_NOISE, "jitter_m": 0.004},
}


@pytest.mark.parametrize(
    ("how", "shares", "count"),
    [
        ("equal", (0.4, 0.35, 0.25), 100),
        ("with odometry that trembles", (0.7, 0.3), 300),
    ],
)
def test_any_number_of_images_of_one_view_is_worth_one_image(how, shares, count):
    localizer = ParticleLocalizer(None, rng=RNG(0))
    estimates = stand(localizer, shares, count, **WAYS_TO_STAND[how])
    begun, ended = weights_of(estimates[0], ALIKE[: len(shares)]), weights_of(estimates[-1], ALIKE[: len(shares)])
    np.testing.assert_allclose(ended, begun, atol=0.01)
    assert all(estimate.status == "ambiguous" for estimate in estimates)
    for mode in estimates[-1].modes:
        assert (stds_of(mode) > 0.98 * np.sqrt(ERRORS.correlated_fraction) * STD).all()
    assert sum(estimate.novelty for estimate in estimates[1:]) < 0.05


def test_standing_before_many_light_places_leaks_no_weight():
    """Parts of a hypothesis that are too light go to its other parts: what is seen twice changes no weight."""
    around = 0.25 * np.pi * np.arange(8)
    places = np.zeros((10, 6))
    places[1:, 0] = 10.0
    places[2:, 0] += 3.0 * STD[0] * np.cos(around)
    places[2:, 1] = 3.0 * STD[0] * np.sin(around)
    seen = seen_at(Poses.exp(places), [0.42, 0.42, *[0.02] * 8])
    localizer, weights = ParticleLocalizer(None, rng=RNG(0)), []
    for i in range(200):
        estimate = localizer.update(seen, STAY if i else None)
        weights.append(np.exp(estimate.log_weights)[estimate.particles.translation[:, 0] > 5.0].sum())
    assert weights[-1] == pytest.approx(weights[0], abs=3e-4)


def test_looking_around_does_not_take_an_error_of_position_away():
    """It is along the axes of the map: of the camera's own, it would differ from the camera's place as that turns."""
    noise = replace(ERRORS, length_rad=1e3)
    localizer, turn = ParticleLocalizer(None, rng=RNG(0)), Poses.exp(np.array([0, 0, 0, 0, 0, 0.1]))
    pose, off = Poses.exp(np.array([0, 0, 0, 0, 0, 1.2])), np.array([0.1, 0.0, 0.0])
    for i in range(126):
        seen = Poses(pose.rotation[None], off[None])
        estimate = localizer.update(seen_at(seen, noise=noise), Odometry(turn, np.diag(AT_REST**2), 0.1) if i else None)
        pose = pose @ turn
    (mode,) = estimate.modes
    assert (stds_of(mode)[:3] > 0.95 * np.sqrt(noise.correlated_fraction) * STD[:3]).all()
    np.testing.assert_allclose(mode.world_from_camera.translation, off, atol=0.01)


def test_an_error_along_the_map_is_the_same_from_the_base_of_a_camera_however_it_is_mounted():
    mount = Poses.exp(np.array([0.5, 0.0, 1.0, 0.3, -0.2, 1.1]))  # reference_from_camera
    for turned_rad in (0.0, 2.0):
        seen = Poses.exp(np.array([1.0, 2.0, 0.5, 0.0, 0.1, turned_rad]))
        posterior = seen_at(seen, std=np.array([0.1, 0.05, 0.02, 0.03, 0.02, 0.01]))
        of_base = posterior.seen_from(mount)
        expected = mount.adjoint() @ along_map(posterior.factors, posterior.means.rotation)
        np.testing.assert_allclose(along_map(of_base.factors, of_base.means.rotation), expected, atol=1e-12)
        squared = of_base.factors @ np.swapaxes(of_base.factors, 1, 2)
        np.testing.assert_allclose(squared, of_base.covariances, atol=1e-12)


STEP_PER_S = np.array([1.0, 0, 0, 0, 0, 0.2])
WHITE = np.array([0.01] * 3 + [0.005] * 3)  # of odometry, after one second
FASTEST = 30


def walk_at_rates(seed, rates, seconds=6):
    """The last estimate at each rate, of one walk past like places whose images err as the model says."""
    rng, count = RNG(seed), seconds * FASTEST + 1
    step = Poses.exp(STEP_PER_S / FASTEST)
    distance = np.hypot(1.0 / ERRORS.length_m, 0.2 / ERRORS.length_rad) / FASTEST
    error = image_errors([distance] * (count - 1), ERRORS, rng=rng)
    truth = [Poses.identity()]
    odometry = []
    for _ in range(count - 1):
        truth.append(truth[-1] @ step)
        noise = Poses.exp(WHITE / np.sqrt(FASTEST) * rng.standard_normal(6))
        odometry.append(Odometry(step @ noise, np.diag(WHITE**2) / FASTEST, 1 / FASTEST))
    estimates, noise = [], replace(ERRORS, weight_power=0.1)
    for rate in rates:
        localizer, apart = ParticleLocalizer(None, rng=RNG(0)), FASTEST // rate
        for i in range(0, count, apart):
            since = None
            for part in odometry[max(i - apart, 0) : i]:
                since = part if since is None else since.then(part)
            seen = lifted(truth[i] @ Poses.exp(error[i]), ALIKE)
            estimate = localizer.update(seen_at(seen, (0.5, 0.25, 0.05), noise=noise), since)
        estimates.append(estimate)
    return estimates


@pytest.mark.parametrize("seed", range(2))
def test_a_walk_at_3_10_and_30_images_a_second_gives_the_same_belief(seed):
    """But for what the fresh share of the errors tells when it is seen ten times as often: a tenth of a std."""
    estimates = walk_at_rates(seed, (3, 10, 30))
    weights = np.array([weights_of(estimate) for estimate in estimates])
    begun = np.sqrt([0.5, 0.25, 0.05])
    assert weights[0, 0] > 1.5 * begun[0] / begun.sum()  # precondition: the way has told something
    np.testing.assert_allclose(weights, weights[[1] * 3], atol=0.02)
    stds = np.array([np.sqrt(np.diag(estimate.modes[0].covariance)) for estimate in estimates])
    np.testing.assert_allclose(stds, stds[[1] * 3], rtol=0.12)
    poses = [estimate.modes[0].world_from_camera for estimate in estimates]
    for pose, std in zip(poses, stds, strict=True):
        assert (np.abs((poses[1].inverse() @ pose).log()) < 1.5 * std).all()


BIAS = OdometryBias(scale=0.03, drift=(0.01,) * 3 + (0.004,) * 3, time_s=10.0)


def squared_error(seed, rate=4, seconds=6):
    """Squared Mahalanobis distance of the truth at the end of a walk of which all is drawn as the models say."""
    rng, count = RNG(seed), seconds * rate + 1
    step = Poses.exp(STEP_PER_S / rate)
    distance = np.hypot(1.0 / ERRORS.length_m, 0.2 / ERRORS.length_rad) / rate
    error = image_errors([distance] * (count - 1), ERRORS, rng=rng)
    constant = np.sqrt(np.diag(ERRORS.constant_covariance(np.zeros((6, 6))))) * rng.standard_normal(6)
    scale = BIAS.scale * rng.standard_normal() * np.array([1.0, 1, 1, 0, 0, 0]) * STEP_PER_S
    drift = wandering([1 / rate / BIAS.time_s] * (count - 1), 6, rng=rng) * np.array(BIAS.drift)
    truth, localizer = Poses.identity(), ParticleLocalizer(None, LocalizerConfig(odometry_bias=BIAS), rng=rng)
    for i in range(count):
        odometry = None
        if i:
            erred = -(scale + drift[i - 1]) / rate + WHITE / np.sqrt(rate) * rng.standard_normal(6)
            truth = truth @ step @ Poses.exp(erred)
            odometry = Odometry(step, np.diag(WHITE**2) / rate, 1 / rate)
        seen = truth @ Poses.exp(constant + error[i])
        if rng.random() < 0.05:
            seen = Poses(seen.rotation, seen.translation + rng.uniform(-30, 30, 3))
        estimate = localizer.update(seen_at(seen), odometry)
    mode = estimate.modes[0]
    off = (mode.world_from_camera.inverse() @ truth).log()
    return off @ np.linalg.solve(mode.covariance, off)


def test_regions_hold_at_least_what_they_say_with_outliers_and_the_defaults():
    squared = np.array([squared_error(seed) for seed in range(60)])
    for probability in (0.5, 0.9, 0.95):
        held = (squared < chi2.ppf(probability, 6)).mean()
        assert held > probability - 2 * np.sqrt(probability * (1 - probability) / 60)
    assert squared.mean() > 3.0  # nor are they far too wide


@pytest.mark.parametrize(("outlier_lengths", "kept"), [(1.0, False), (12.0, True)])
def test_a_corridor_that_is_taken_for_another_is_one_mistake_if_such_mistakes_last(outlier_lengths, kept):
    noise = replace(ERRORS, outlier_lengths=outlier_lengths)
    localizer = ParticleLocalizer(None, LocalizerConfig(), rng=RNG(0))
    step = 0.5 * noise.length_m
    poses = [Poses(np.eye(3), np.array([step * i, 0.0, 0.0])) for i in range(100)]
    for i, pose in enumerate(poses):
        shares = (1.0, 0.0) if i < 80 else (0.02, 0.98)  # ten lengths along which the other noise_floor seems likelier
        seen = replace(seen_at(lifted(pose, ALIKE[:2]), shares), noise=noise)
        odometry = Odometry(Poses(np.eye(3), np.array([step, 0.0, 0.0])), np.diag(AT_REST**2), 0.5) if i else None
        estimate = localizer.update(seen, odometry)
    assert (weights_of(estimate, ALIKE[:2])[0] > 0.9) == kept
