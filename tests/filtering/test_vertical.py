"""Gravity and height as measurements: exact where all is linear, and no surer for being repeated."""

from dataclasses import replace

import numpy as np
import pytest

from filtering.config import LocalizerConfig
from filtering.errors import VaporTrackError
from filtering.fixed_lag import FixedLagSmoother
from filtering.hindsight import FilterStep
from filtering.hypotheses import correlated_error
from filtering.kalman import KalmanLocalizer
from filtering.localizer import ParticleLocalizer
from filtering.measurement_noise import MeasurementNoise
from filtering.motion import Odometry, OdometryBias
from filtering.observation import Observation, View
from filtering.se3 import Poses
from filtering.smoothing import SmoothingConfig, smooth
from filtering.vertical import LASTING, HeightsAt, KnownHeight, Vertical, vertical_errors
from tests.helpers.modelled_walk import BIAS, ERRORS, walk
from tests.helpers.simulation import AHEAD, RNG, STAY, STD, assert_same_belief, lifted, new_localizer, seen_at

UPRIGHT = Poses.from_matrix(np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 1.5], [0, 0, 0, 1]]))
UP = (0.0, -1.0, 0.0)  # of a camera that looks level
LEVEL = Vertical(UP, 0.01, KnownHeight(1.5, 0.02))
ALONE = {"birth_rate": 0.0, "max_birth_rate": 0.0, "odometry_failures_per_s": 0.0, "adapt_errors": False}


class Ramp:
    """Floors that rise by 0.2 in x, and by -0.1 in y."""

    def at(self, positions):
        slope = np.tile([0.2, -0.1, 0.0], (len(positions), 1))
        return HeightsAt(1.5 + np.vecdot(positions, slope), slope, np.full(len(positions), 0.05))


def moved(pose, *tangent):
    return pose @ Poses.exp(np.array(tangent))


def observed(pose, odometry, vertical, *, noise=None, std=STD):
    noise = noise or MeasurementNoise(constant_fraction=0.0)
    return replace(Observation.of_posterior(seen_at(pose, std=std, noise=noise), odometry, 0.1), vertical=vertical)


def seen_upright(count, vertical, *, odometry=STAY, **settings):
    """The estimates of a camera that is seen upright at its place again and again."""
    localizer, pose, estimates = new_localizer(**ALONE, **settings), UPRIGHT, []
    for i in range(count):
        pose = pose @ odometry.previous_from_current if i else pose
        estimates.append(localizer.advance(observed(pose, odometry, vertical)))
    return estimates, localizer


def tilt_and_height_std(estimate):
    """About the camera's x and z axes, and along the world's z axis, of a camera that looks level."""
    std = np.sqrt(np.diag(estimate.modes[0].covariance))
    return std[[3, 5, 1]]


# --- one measurement ------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(5))
def test_the_jacobian_is_that_of_a_pose_times_a_small_motion(seed):
    rng = RNG(seed)
    pose = Poses.exp(rng.standard_normal((1, 6)))
    seen = pose.rotation[0].T @ [0, 0, 1.0] + 1e-3 * rng.standard_normal(3)  # the Jacobian is at a small difference
    vertical = Vertical(tuple(seen / np.linalg.norm(seen)), 0.01, Ramp())
    found, step = vertical_errors(vertical, pose), 1e-6
    for axis, unit in enumerate(np.eye(6)):
        after = vertical_errors(vertical, pose @ Poses.exp(step * unit))
        # Bases across up differ by a small turn only.
        change = (after.innovation - found.innovation)[0] / step
        np.testing.assert_allclose(change, -found.of_pose[0, :, axis], atol=5e-3)


def test_one_measurement_gives_tilt_and_height_as_exactly_as_it_is_and_leaves_heading_and_way():
    (without,), _ = seen_upright(1, None)
    (level,), _ = seen_upright(1, LEVEL)
    prior, std = np.sqrt(np.diag(without.modes[0].covariance)), np.sqrt(np.diag(level.modes[0].covariance))
    exact = 1 / np.hypot(1 / prior[[3, 5, 1]], 1 / np.array([0.01, 0.01, 0.02]))
    np.testing.assert_allclose(tilt_and_height_std(level), exact, rtol=1e-6)
    np.testing.assert_allclose(std[[0, 2, 4]], prior[[0, 2, 4]], rtol=1e-6)


def test_gravity_turns_a_tilted_camera_back_and_a_height_lifts_it():
    localizer = new_localizer(**ALONE)
    tilted = moved(UPRIGHT, 0, 0.1, 0, 0.05, 0, -0.04)
    estimate = localizer.advance(observed(tilted, None, Vertical(UP, 1e-3, KnownHeight(1.5, 1e-3))))
    pose = estimate.modes[0].world_from_camera
    np.testing.assert_allclose(pose.rotation.T @ [0, 0, 1], UP, atol=2e-3)
    assert abs(pose.translation[2] - 1.5) < 2e-3
    assert np.linalg.norm((pose.translation - tilted.translation)[:2]) < 0.01


def test_of_an_unknown_height_nothing_is_taken():
    class Nowhere:
        def at(self, positions):
            none = np.zeros(len(positions))
            return HeightsAt(none, np.zeros((len(positions), 3)), none + np.inf)

    (without,), _ = seen_upright(1, None)
    (unknown,), _ = seen_upright(1, Vertical(heights=Nowhere()))
    np.testing.assert_allclose(unknown.modes[0].covariance, without.modes[0].covariance, atol=1e-12)


def test_on_a_ramp_a_height_says_something_of_the_way_up_it():
    (estimate,), _ = seen_upright(1, Vertical(heights=Ramp()))
    covariance = estimate.modes[0].covariance[:3, :3]
    rotated = UPRIGHT.rotation @ covariance @ UPRIGHT.rotation.T
    along = np.array([-0.2, 0.1, 1.0])
    assert np.sqrt(along @ rotated @ along) < 0.051
    assert rotated[0, 2] > 0.0


@pytest.mark.parametrize(
    "wrong",
    [
        {"up": (0.0, 0.0, 2.0)},
        {"up": (0.0, 0.0, np.nan)},
        {"world_up": (0.0, 1.0, 1.0)},
        {"tilt_std_rad": 0.0},
        {"tilt_std_rad": np.nan},
        {"lengths": 0.0},
        {"lengths": np.nan},
    ],
)
def test_impossible_numbers_are_refused(wrong):
    with pytest.raises(VaporTrackError, match=next(iter(wrong))):
        Vertical(**wrong)


# --- the exact answer -----------------------------------------------------------------------------------

NOISE = MeasurementNoise(
    degrees_of_freedom=1e6,
    outlier_probability=1e-9,
    log_clutter_density=-500.0,
    constant_fraction=0.0,
    correlated_fraction=0.7,
    typical_std=(0.03, 0.05, 0.04, 2e-5, 1e-5, 3e-5),
)
EXACT_STD = np.array(NOISE.typical_std)
MOTION_STD = np.array([0.004, 0.003, 0.002, 2e-6, 3e-6, 1e-6])
TILT_STD, HEIGHT_STD = 1.5e-5, 0.02


def linear_walk(rng, count):
    """Verticals and images of a camera that goes along x, about the identity, and its odometry."""
    step, vertical_error, pose = np.array([0.1, 0, 0, 0, 0, 0]), 0.3 * rng.standard_normal(3), np.zeros(6)
    for t in range(count):
        pose = pose + (step + MOTION_STD * rng.standard_normal(6) if t else 0)
        x, y, height = pose[3], pose[4], pose[2]
        x, y = np.array([x, y]) + TILT_STD * (vertical_error[:2] + 0.2 * rng.standard_normal(2))
        up = Poses.exp(np.array([0, 0, 0, x, y, 0.0])).rotation.T @ [0, 0, 1.0]
        known = KnownHeight(height + HEIGHT_STD * (vertical_error[2] + 0.2 * rng.standard_normal()), HEIGHT_STD)
        seen = Poses.exp((pose + 0.5 * EXACT_STD * rng.standard_normal(6))[None])
        vertical = Vertical(tuple(up), TILT_STD, known, lengths=2.0)
        odometry = Odometry(Poses.exp(step), np.diag(MOTION_STD**2), 0.1) if t else None
        yield seen, (np.array([x, y, known.height_m])), odometry, vertical


def kalman_filter(observations):
    """The filter as linear algebra, of the state (v, ω, error of images, of verticals): means and covariances."""
    mean, covariance = np.zeros(18), np.diag(np.concatenate([1e6 * EXACT_STD**2, np.ones(12)]))
    of_image, of_vertical = np.zeros((6, 18)), np.zeros((3, 18))
    of_image[:, :6], of_image[:, 6:12] = np.eye(6), np.sqrt(0.7) * np.diag(EXACT_STD)
    stds = np.array([TILT_STD, TILT_STD, HEIGHT_STD])
    for row, (pose, error) in enumerate(((3, 15), (4, 16), (2, 12))):
        of_vertical[row, pose], of_vertical[row, error] = 1.0, np.sqrt(LASTING) * stds[row]
    for t, (seen, measured, odometry, _) in enumerate(observations):
        if t:
            step = odometry.previous_from_current.log()
            transition, noise = np.eye(18), np.zeros(18)
            transition[1, 5], transition[2, 4] = step[0], -step[0]
            noise[:6] = MOTION_STD**2
            for part, lengths in ((slice(6, 12), 1.0), (slice(12, 18), 2.0)):
                kept = np.exp(-step[0] / NOISE.length_m / lengths)
                transition[part, part], noise[part] = kept * np.eye(6), 1 - kept**2
            mean, covariance = transition @ mean, transition @ covariance @ transition.T + np.diag(noise)
            mean[:6] += step
        for value, matrix, variance in (
            (seen.log()[0], of_image, 0.3 * EXACT_STD**2),
            (measured, of_vertical, (1 - LASTING) * stds**2),
        ):
            gain = covariance @ matrix.T @ np.linalg.inv(matrix @ covariance @ matrix.T + np.diag(variance))
            mean = mean + gain @ (value - matrix @ mean)
            keeps = np.eye(18) - gain @ matrix
            covariance = keeps @ covariance @ keeps.T + gain @ np.diag(variance) @ gain.T
        yield mean, covariance


@pytest.mark.parametrize("seed", [0, 1])
def test_where_all_is_linear_and_gaussian_filter_baseline_and_smoother_are_the_kalman_filter(seed):
    bias = OdometryBias(scale=0.0, relative_drift=0.0)
    config = LocalizerConfig(**ALONE, odometry_bias=bias)
    localizer, baseline = ParticleLocalizer(None, config, rng=RNG(0)), KalmanLocalizer()
    baseline.config = replace(baseline.config, odometry_bias=bias, adapt_errors=False)
    observations, steps = list(linear_walk(RNG(seed), 40)), []
    for (seen, _, odometry, vertical), (mean, covariance) in zip(
        observations, kalman_filter(observations), strict=True
    ):
        observation = observed(seen, odometry, vertical, noise=NOISE, std=EXACT_STD)
        estimate, mode = localizer.advance(observation), baseline.advance(observation)
        steps.append(FilterStep.of(observation, estimate))
        std = np.sqrt(np.diag(covariance))[:6]
        for pose, of_pose in (
            (estimate.modes[0].world_from_camera, estimate.modes[0].covariance),
            (mode.world_from_camera, mode.covariance),
        ):
            np.testing.assert_allclose(pose.log() / std, mean[:6] / std, atol=2e-3)
            np.testing.assert_allclose(of_pose / np.outer(std, std), covariance[:6, :6] / np.outer(std, std), atol=2e-3)
        own = correlated_error(1)
        lasting = localizer.belief.hypotheses.mean[0, own.start - 6 : own.stop - 6]
        np.testing.assert_allclose(lasting, mean[12:], atol=2e-3)
    settings = replace(SmoothingConfig.of_filter(config), adapt_errors=False)
    best = smooth(steps, NOISE, settings).best
    np.testing.assert_allclose(best.poses[-1].log() / std, mean[:6] / std, atol=0.02)
    np.testing.assert_allclose(
        best.covariance[-1] / np.outer(std, std), covariance[:6, :6] / np.outer(std, std), atol=0.02
    )
    smoother = FixedLagSmoother(100.0, NOISE, settings)
    given = [pose for step in steps for pose in smoother.update(step)] + smoother.finish()
    np.testing.assert_allclose(given[20].world_from_camera.log() / std, best.poses[20].log() / std, atol=0.02)
    unit = np.sqrt(np.diag(best.covariance[20]))
    scale = np.outer(unit, unit)
    np.testing.assert_allclose(given[20].covariance / scale, best.covariance[20] / scale, atol=0.02)


# --- repetition is no evidence --------------------------------------------------------------------------


def test_a_standing_camera_does_not_become_surer_than_the_lasting_error_however_often_it_is_measured():
    lasting = np.sqrt(LASTING) * np.array([0.01, 0.01, 0.02])
    for seconds in (0.1, 0.01):
        still = Odometry(Poses.identity(), np.zeros((6, 6)), seconds)
        estimates, _ = seen_upright(300, LEVEL, odometry=still)
        prior = np.sqrt(0.7) * STD[[3, 5, 1]]
        assert (tilt_and_height_std(estimates[-1]) > 0.99 / np.hypot(1 / lasting, 1 / prior)).all()


def test_an_unusual_measurement_repeated_while_standing_counts_once():
    still = Odometry(Poses.identity(), np.zeros((6, 6)), 0.1)
    estimates, _ = seen_upright(200, Vertical(heights=KnownHeight(1.9, 0.02)), odometry=still)
    off_m = [estimate.modes[0].world_from_camera.translation[2] - 1.5 for estimate in (estimates[0], estimates[-1])]
    assert off_m[1] < off_m[0] + 0.01


def test_the_rate_of_images_and_measurements_does_not_matter():
    std = []
    for rate in (1, 5):
        part = Odometry(
            Poses.exp(np.array([0, 0, 0.2 / rate, 0, 0, 0])), np.diag(np.repeat([4e-4, 1e-4], 3)) / rate, 0.2 / rate
        )
        estimates, _ = seen_upright(40 * rate, LEVEL, odometry=part)
        std.append(tilt_and_height_std(estimates[-1]))
    np.testing.assert_allclose(std[1], std[0], rtol=0.1)


def test_lengths_in_another_unit_give_the_same_times_that():
    unit, found = 30.0, []
    for scale in (1.0, unit):
        path = walk(30, rng=RNG(3), unit=scale)
        localizer = ParticleLocalizer(None, LocalizerConfig(odometry_bias=BIAS), rng=RNG(0))
        for posterior, odometry, pose in zip(path.posteriors, path.odometry, path.truth, strict=True):
            known = KnownHeight(pose.translation[2] + 0.01 * scale, 0.02 * scale)
            vertical = Vertical(tuple(pose.rotation.T @ [0, 0, 1]), 0.01, known)
            estimate = localizer.advance(replace(Observation.of_posterior(posterior, odometry, 0.1), vertical=vertical))
        found.append(estimate.modes[0].world_from_camera)
    np.testing.assert_allclose(found[1].translation, unit * found[0].translation, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(found[1].rotation, found[0].rotation, atol=1e-9)


def test_an_error_that_lasts_for_ever_is_no_smaller_after_a_long_way():
    ahead = Odometry(Poses.exp(np.array([0, 0, 0.5, 0, 0, 0])), np.diag(np.repeat([1e-6, 1e-8], 3)), 0.1)
    fading, _ = seen_upright(100, LEVEL, odometry=ahead)
    lasting, _ = seen_upright(100, replace(LEVEL, lengths=np.inf), odometry=ahead)
    assert tilt_and_height_std(fading[-1])[2] < 0.4 * 0.02
    images = STD[1] / np.sqrt(50)  # a hundred lengths
    assert tilt_and_height_std(lasting[-1])[2] > 0.95 / np.hypot(1 / (np.sqrt(LASTING) * 0.02), 1 / images)


# --- which place ----------------------------------------------------------------------------------------


def test_a_place_that_is_upside_down_loses_and_one_at_another_height_does():
    fallen = UPRIGHT @ Poses.exp(np.array([3.0, 0, 0, 0, 0, 3.1]))
    both = Poses.stack([UPRIGHT, fallen])
    for places, vertical in (
        (both, Vertical(UP, 0.02)),
        (lifted(UPRIGHT, (0.0, 3.0)), Vertical(heights=KnownHeight(1.5, 0.1))),
    ):
        posterior = seen_at(places, (0.5, 0.5))
        for known, least in ((None, 0.0), (vertical, 0.9)):
            estimate = new_localizer().advance(replace(Observation.of_posterior(posterior, None), vertical=known))
            right = [mode for mode in estimate.modes if (mode.world_from_camera.distance(UPRIGHT)[0] < 0.3)]
            assert right[0].weight > least
            assert known is not None or right[0].weight < 0.6


def test_a_wrong_measurement_leaves_the_place_to_the_images():
    localizer, pose = new_localizer(), UPRIGHT
    upside_down = Vertical((0.0, 1.0, 0.0), 0.01, KnownHeight(40.0, 0.02))
    for _ in range(40):
        pose = pose @ AHEAD.previous_from_current
        estimate = localizer.advance(observed(pose, AHEAD, upside_down))
    metres, radians = estimate.modes[0].world_from_camera.distance(pose)
    assert estimate.status == "converged"
    assert metres < 0.1
    assert radians < 0.05


def test_without_measurements_the_state_is_no_larger():
    _, localizer = seen_upright(2, None)
    assert localizer.belief.hypotheses.covariance.shape[1] == 19
    _, localizer = seen_upright(2, LEVEL)
    assert localizer.belief.hypotheses.covariance.shape[1] == 25


# --- in time --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", [[0, 2, 1, 3, 4], [0, 4, 3, 2, 1]])
def test_late_images_with_their_verticals_give_the_belief_of_those_in_order(order):
    step = Poses.exp(np.array([0, 0, 0.2, 0, 0.1, 0]))

    def come(indices):
        localizer, done = new_localizer(late_window_s=0.5), []
        for index in indices:
            since = [i for i in done if i < index]
            motions = [Odometry(step, 1e-4 * np.eye(6), 0.1)] * (index - max(since)) if since else []
            whole = None
            for each in motions:
                whole = each if whole is None else whole.then(each)
            pose = UPRIGHT
            for _ in range(index):
                pose = pose @ step
            view = View(seen_at(lifted(pose, (0.0, 3.0)), (0.6, 0.3)), Poses.identity(), "camera")
            vertical = Vertical(UP, 0.01, KnownHeight(1.5 + 0.001 * index, 0.02))
            estimate = localizer.advance(Observation((view,), whole, time_ns=10**9 + index * 10**8, vertical=vertical))
            done.append(index)
        return estimate

    assert_same_belief(come(order), come(sorted(order)), rtol=0, atol=1e-9)


def test_the_smoother_is_closer_to_the_true_tilt_and_height_with_them():
    errors = {}
    for known in (False, True):
        path = walk(80, rng=RNG(5), speed_m=0.2)
        localizer, steps = ParticleLocalizer(None, LocalizerConfig(odometry_bias=BIAS), rng=RNG(0)), []
        for posterior, odometry, pose in zip(path.posteriors, path.odometry, path.truth, strict=True):
            vertical = Vertical(tuple(pose.rotation.T @ [0, 0, 1]), 0.01, KnownHeight(pose.translation[2], 0.02))
            observation = Observation.of_posterior(posterior, odometry, 0.1)
            observation = replace(observation, vertical=vertical if known else None)
            steps.append(FilterStep.of(observation, localizer.advance(observation)))
        best = smooth(steps, ERRORS, SmoothingConfig.of_filter(localizer.config)).best
        error = best.poses.between(path.truth).log()
        errors[known] = np.sqrt(np.mean(np.square(error), axis=0))
    assert (errors[True][[3, 4, 2]] < 0.5 * errors[False][[3, 4, 2]]).all()


def test_with_a_lag_a_standing_camera_gains_nothing_by_gravity_said_again_and_again():
    """Gravity is off by six standard deviations: the filter, and every smoother, takes it once."""
    std = np.array([0.1, 0.1, 0.1, 0.01, 0.01, 0.01])
    off = np.array([np.sin(0.06), 0.0, np.cos(0.06)])
    vertical, localizer, steps = Vertical(tuple(off.tolist()), 0.01), new_localizer(), []
    for i in range(60):
        observation = Observation.of_posterior(seen_at(Poses.identity(), std=std), Odometry.still(0.1) if i else None)
        observation = replace(observation, vertical=vertical)
        steps.append(FilterStep.of(observation, localizer.advance(observation)))
    smoothed = smooth(steps, ERRORS, SmoothingConfig.of_filter(LocalizerConfig())).best.poses
    for lag_s in (1.0, 20.0):
        lag = FixedLagSmoother(lag_s, ERRORS)
        lagged = [pose for step in steps for pose in lag.update(step)] + lag.finish()
        tilt = np.arccos(np.clip(lagged[-1].world_from_camera.rotation[2, 2], -1.0, 1.0))
        assert tilt < 2.0 * np.arccos(np.clip(smoothed[-1].rotation[2, 2], -1.0, 1.0)) + 0.005
