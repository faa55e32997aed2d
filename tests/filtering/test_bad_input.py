"""Bad input: each kind has a documented outcome, an error that carries the value or a defined status; never a NaN."""

import re
from dataclasses import fields, replace
from types import SimpleNamespace

import numpy as np
import pytest

from filtering.config import GapConfig, LocalizerConfig
from filtering.density import KernelDensity
from filtering.errors import VaporTrackError
from filtering.estimate import ModeConfig
from filtering.kalman import KalmanConfig
from filtering.localizer import ParticleLocalizer
from filtering.measurement_noise import MeasurementNoise
from filtering.motion import MotionNoise, Odometry, OdometryBias, require_odometry
from filtering.se3 import Poses
from filtering.smoothing import SmoothingConfig
from tests.helpers.simulation import ERRORS, ODOMETRY_STD, Oracle, climb, image_of, lifted, new_localizer, seen_at

GOOD = np.diag(ODOMETRY_STD**2)


def walking(num_frames, num_before=3):
    """A localizer that has taken the first steps of a walk, and the walk."""
    rng = np.random.default_rng(0)
    truth, odometry = climb(num_frames, rng=rng)
    localizer = ParticleLocalizer(Oracle(truth, (0, 1, 2), range(0)), rng=rng)
    for i in range(num_before):
        localizer.step(image_of(i), odometry[i])
    return localizer, truth, odometry


def assert_same(one, other):
    np.testing.assert_array_equal(one.particles.translation, other.particles.translation)
    np.testing.assert_array_equal(one.log_weights, other.log_weights)
    np.testing.assert_array_equal(one.covariances, other.covariances)
    assert (one.status, one.agreement, one.novelty, one.normalized_distance) == (
        other.status, other.agreement, other.novelty, other.normalized_distance
    )  # fmt: skip


def assert_sound(estimate):
    """Nothing in an estimate is NaN, weights are normalised, covariances are some."""
    assert estimate.particles.is_finite().all()
    assert np.exp(estimate.log_weights).sum() == pytest.approx(1.0)
    assert 0.0 <= estimate.agreement <= 1.0
    for mode in estimate.modes:
        assert mode.world_from_camera.is_finite()
        assert np.linalg.eigvalsh(mode.covariance).min() > 0.0
    rotation = estimate.modes[0].world_from_camera.rotation
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-6)


# --- odometry that is none --------------------------------------------------------------------------


def increment(rotation=None, translation=(0.0, 0.0, 0.0), covariance=GOOD):
    return Odometry(Poses(np.eye(3) if rotation is None else rotation, np.array(translation)), covariance, 0.1)


BAD_ODOMETRY = [
    (increment(covariance=np.full((6, 6), np.nan)), "covariance is not finite"),
    (increment(covariance=np.diag([1.0] * 5 + [np.inf])), "covariance is not finite"),
    (increment(covariance=np.diag([1.0, 1, 1, 1, 1, -0.5])), "negative eigenvalue -0.5"),
    (increment(covariance=np.eye(6) + np.eye(6, k=1)), "not symmetric"),
    (increment(translation=(np.nan, 0, 0)), r"increment is not finite: .*nan"),
    (increment(translation=(0, np.inf, 0)), r"increment is not finite: .*inf"),
    (increment(rotation=1.01 * np.eye(3)), r"1.01.* for a rotation, expected orthonormal"),
    (increment(rotation=np.zeros((3, 3))), "expected orthonormal"),
    (increment(rotation=np.diag([1.0, 1, -1])), "determinant 1"),
    (Odometry(Poses.identity(), GOOD, -0.1), r"took -0.1 s, expected a finite duration"),
    (Odometry(Poses.identity(), GOOD, float("nan")), r"took nan s, expected a finite duration"),
    (Odometry(Poses.identity(2), GOOD, 0.1), r"batch shape \(2,\), expected \(\)"),
]


@pytest.mark.parametrize(("odometry", "message"), BAD_ODOMETRY)
def test_odometry_that_is_none_is_refused_with_its_value_and_the_localizer_stays_as_it_was(odometry, message):
    """Nor is the image of the refused step taken for one of a frozen camera when it comes again."""
    (localizer, _, walked), (untouched, _, _) = walking(5), walking(5)
    with pytest.raises(VaporTrackError, match=message):
        localizer.step(image_of(3), odometry)
    with pytest.raises(VaporTrackError, match=message):
        localizer.predict(odometry)
    for i in (3, 4):
        assert_same(localizer.step(image_of(i), walked[i]), untouched.step(image_of(i), walked[i]))


def test_odometry_of_a_first_step_is_not_used_whatever_it_is():
    expected = walking(1, num_before=0)[0].step(image_of(0), None)
    far = increment(translation=(50.0, 0, 0))
    for odometry in (far, *(bad for bad, _ in BAD_ODOMETRY)):
        assert_same(walking(1, num_before=0)[0].step(image_of(0), odometry), expected)


def test_a_rotation_in_single_precision_passes():
    rotation = Poses.exp(np.array([0.0, 0, 0, 0.3, -0.2, 1.1])).rotation.astype(np.float32).astype(np.float64)
    require_odometry(increment(rotation))


# --- odometry that is odd ---------------------------------------------------------------------------

ROOT = np.array([1.0, -2.0, 0.5, 0.1, 0.2, -0.3])


@pytest.mark.parametrize(
    "change",
    [
        {"duration_s": 0.0},
        {"covariance": np.zeros((6, 6))},
        {"covariance": np.diag([1e-4, 0, 0, 0, 0, 0])},
        {"covariance": 1e-4 * np.outer(ROOT, ROOT)},
        {"covariance": 1e-30 * np.eye(6)},
    ],
)
def test_a_motion_in_no_time_and_a_covariance_of_rank_one_or_zero_are_fine(change):
    localizer, truth, odometry = walking(30)
    for i in range(3, 30):
        estimate = localizer.step(image_of(i), replace(odometry[i], **change))
        assert_sound(estimate)
    assert estimate.modes[0].world_from_camera.distance(truth[29])[0] < 0.3


# --- posteriors that are odd ------------------------------------------------------------------------


@pytest.mark.parametrize(
    "odd",
    [
        lambda pose: seen_at(pose, (0.0,)),
        lambda pose: seen_at(pose, (1e-300,)),
        lambda pose: seen_at(pose, std=[1e-9] * 6),
        lambda pose: seen_at(pose, std=[1e6] * 3 + [3.0] * 3),
        lambda pose: seen_at(Poses(pose.rotation, pose.translation + 1e9)),
        lambda pose: seen_at(Poses.concatenate([lifted(pose, [0.0] * 40)]), [1 / 40] * 40),
    ],
    ids=["no share", "hardly a share", "as if exact", "anywhere", "a light second away", "forty times one place"],
)
def test_a_posterior_that_is_odd_gives_a_belief_that_is_sound(odd):
    localizer, _, odometry = walking(12)
    pose = localizer.predict(increment()).modes[0].world_from_camera
    for i in range(4, 8):
        pose = pose @ odometry[i].previous_from_current
        assert_sound(localizer.update(odd(pose), odometry[i]))
    for i in range(8, 12):
        assert_sound(localizer.step(image_of(i), odometry[i]))


def test_a_first_posterior_whose_weights_are_all_zero_is_refused():
    localizer = ParticleLocalizer(None, rng=np.random.default_rng(0))
    with pytest.raises(VaporTrackError, match="no place of any weight"):
        localizer.update(seen_at(lifted(Poses.identity(), (0.0, 3.0)), (0.0, 0.0)), None)


# --- a step that raises -----------------------------------------------------------------------------


def test_an_image_that_the_model_refuses_leaves_the_localizer_as_it_was():
    def refuse(image, *, rng):
        rng.standard_normal(17)
        raise VaporTrackError("no image of this camera")

    (localizer, _, walked), (untouched, _, _) = walking(6), walking(6)
    good, localizer.model = localizer.model, SimpleNamespace(observe=refuse)
    with pytest.raises(VaporTrackError, match="no image of this camera"):
        localizer.step(image_of(3), walked[3])
    localizer.model = good
    for i in range(3, 6):
        assert_same(localizer.step(image_of(i), walked[i]), untouched.step(image_of(i), walked[i]))


def test_an_update_that_raises_draws_nothing(monkeypatch):
    localizers = []
    for _ in range(2):
        localizer = ParticleLocalizer(None, LocalizerConfig(max_hypotheses=3), rng=np.random.default_rng(0))
        localizer.update(seen_at(lifted(Poses.identity(), 3.0 * np.arange(3)), [0.3] * 3), None)
        localizers.append(localizer)
    step = increment(translation=(0.3, 0, 0))
    seen = seen_at(lifted(Poses.exp(np.array([0.3, 0, 0, 0, 0, 0])), 3.0 * np.arange(6)), [0.15] * 6)
    drawn = localizers[0].belief.rng.bit_generator.state

    def broken(belief, *arguments, **_):
        assert belief.rng.bit_generator.state != drawn  # precondition: it has drawn
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr("filtering.step.describe", broken)
        with pytest.raises(KeyboardInterrupt):
            localizers[0].update(seen, step)
    for _ in range(3):
        assert_same(*(localizer.update(seen, step) for localizer in localizers))


def test_samples_and_weights_that_are_not_finite_make_no_density():
    poses = Poses.identity(3)
    poses.translation[1, 2] = np.nan
    with pytest.raises(VaporTrackError, match=r"kernel centre 1 of 3 is not finite: .*nan"):
        KernelDensity(poses, 0.1, 0.1)
    for bad in (np.nan, np.inf):
        with pytest.raises(VaporTrackError, match=f"log weight of kernel 0 of 2 is {bad}"):
            KernelDensity(Poses.identity(2), 0.1, 0.1, np.array([bad, 0.0]))


def test_a_view_from_another_rig_is_judged_by_its_own_measurement_noise():
    localizer = ParticleLocalizer(None, rng=np.random.default_rng(0))
    coarse = ERRORS.scaled(10.0)
    localizer.update(seen_at(Poses.identity(1), noise=coarse), None)
    assert_sound(localizer.update(seen_at(Poses.identity(1), noise=ERRORS), increment(translation=(1.0, 0, 0))))


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("name", ["births", "resampling"])
def test_an_unknown_name_in_the_settings_is_refused_with_those_there_are(name):
    with pytest.raises(VaporTrackError, match=rf"{name} is 'none', expected one of \w+"):
        LocalizerConfig(**{name: "none"})


# --- settings -------------------------------------------------------------------------------------


SETTINGS = (
    *(LocalizerConfig, GapConfig, ModeConfig, KalmanConfig, SmoothingConfig),
    *(MeasurementNoise, MotionNoise, OdometryBias),
)
BEYOND = {int: (-(10**12), 10**12), float: (np.nan, -1e12, 1e12)}
CASES = [
    *(
        (kind, field.name, value)
        for kind in SETTINGS
        for field in fields(kind)
        for value in BEYOND.get(type(field.default), ())
    ),
    (LocalizerConfig, "max_hypotheses", 0),
    (KalmanConfig, "gate_probability", 1.0),
    (MeasurementNoise, "degrees_of_freedom", 0.5),
    (MeasurementNoise, "outlier_probability", 1.0),
    (MeasurementNoise, "correlated_fraction", 1.0),
]


@pytest.mark.parametrize(("kind", "name", "value"), CASES)
def test_settings_out_of_range_are_refused_by_name_and_value(kind, name, value):
    with pytest.raises(VaporTrackError, match=rf"^{name} is {re.escape(str(value))}, expected between "):
        kind(**{name: value})


def test_a_filter_fed_with_posteriors_needs_no_model_and_says_so_when_shown_an_image():
    with pytest.raises(VaporTrackError, match="no observation model"):
        new_localizer().step(image_of(0), None)


def test_a_gap_however_long_leaves_a_belief():
    localizer = ParticleLocalizer(None, rng=np.random.default_rng(0))
    localizer.update(seen_at(Poses.identity(1)), None)
    estimate = localizer.update(seen_at(Poses.identity(1)), None, elapsed_s=1e100)
    assert np.isfinite(estimate.modes[0].covariance).all()


def test_a_variance_beyond_all_bounds_is_refused():
    localizer = ParticleLocalizer(None, rng=np.random.default_rng(0))
    localizer.update(seen_at(Poses.identity(1)), None)
    with pytest.raises(VaporTrackError, match="give no odometry"):
        localizer.update(seen_at(Poses.identity(1)), Odometry(Poses.identity(), 1e100 * np.eye(6), 0.1))
