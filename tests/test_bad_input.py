"""Bad input: each kind has a documented outcome, an error that carries the value or a defined status; never a NaN."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from filtering.density import KernelDensity
from filtering.errors import VaporTrackError
from filtering.localizer import LocalizerConfig, ParticleLocalizer
from filtering.motion import Odometry, require_odometry
from filtering.posterior import PosteriorSamples
from filtering.proposal import Proposal, mixture_log_weights
from filtering.recovery import RecoveryConfig
from filtering.regularisation import KernelConfig
from filtering.se3 import Poses
from tests.simulation import ODOMETRY_STD, Oracle, climb, image_of

SMALL = LocalizerConfig(num_particles=300, kernels=KernelConfig(max_kernels=150))
GOOD = np.diag(ODOMETRY_STD**2)
HERE = KernelDensity(Poses.identity(1), 0.1, 0.1)


def walking(num_frames, seed=0, num_before=3):
    """A localizer that has taken the first steps of a walk in a place that looks like no other, and the walk."""
    rng = np.random.default_rng(seed)
    truth, odometry = climb(num_frames, rng=rng)
    localizer = ParticleLocalizer(Oracle(truth, (0,), range(0)), SMALL, rng=rng)
    for i in range(num_before):
        localizer.step(image_of(i), odometry[i])
    return localizer, truth, odometry


@dataclass
class Answering:
    """A sound posterior, one of whose answers is replaced."""

    method: str
    answer: object

    def __getattr__(self, name):
        sound = getattr(PosteriorSamples(HERE), name)
        return (lambda *args, **kwargs: self.answer(sound(*args, **kwargs))) if name == self.method else sound

    def sample(self, num_samples, *, rng):
        return self.__getattr__("sample")(num_samples, rng=rng)

    def log_density(self, poses):
        return self.__getattr__("log_density")(poses)

    def log_likelihood(self, poses):
        return self.__getattr__("log_likelihood")(poses)


def with_one(value):
    return lambda values: np.concatenate([values[:2], [value], values[3:]])


BAD_ANSWERS = [
    ("log_density", with_one(np.nan), "log_density of Answering is nan at pose 2"),
    ("log_density", with_one(np.inf), "log_density of Answering is inf at pose 2"),
    ("log_likelihood", with_one(np.nan), "log_likelihood of Answering is nan at pose 2"),
    ("log_likelihood", with_one(np.inf), r"log_likelihood of Answering is inf at pose 2 \(1 of 300 are so\)"),
    (
        "log_likelihood",
        lambda v: v[:1],
        r"log_likelihood of Answering returned values of shape \(1,\), expected \(300,",
    ),
    ("log_density", lambda v: v[:, None], r"log_density of Answering returned values of shape \(300, 1\)"),
    ("sample", lambda poses: poses[:0], r"sample of Answering returned poses of shape \(0,\), expected \(30,\)"),
    ("sample", lambda p: Poses(p.rotation, p.translation * np.nan), "sample of Answering returned a pose that is not"),
]


@pytest.mark.parametrize(("method", "answer", "message"), BAD_ANSWERS)
def test_a_posterior_that_answers_nonsense_is_named_and_the_belief_stays(method, answer, message):
    (localizer, _, odometry), (untouched, _, _) = walking(4), walking(4)
    with pytest.raises(VaporTrackError, match=message):
        localizer.update(Answering(method, answer), odometry[3])
    after, expected = localizer.step(image_of(3), odometry[3]), untouched.step(image_of(3), odometry[3])
    np.testing.assert_array_equal(after.particles.translation, expected.particles.translation)
    np.testing.assert_array_equal(after.log_weights, expected.log_weights)
    assert (after.status, after.log_evidence) == (expected.status, expected.log_evidence)


@pytest.mark.parametrize(("method", "answer", "message"), [BAD_ANSWERS[2], BAD_ANSWERS[4]])
def test_a_first_posterior_that_answers_nonsense_is_refused_too(method, answer, message):
    localizer = ParticleLocalizer(Oracle(Poses.identity(1), (0,), range(0)), SMALL, rng=np.random.default_rng(0))
    with pytest.raises(VaporTrackError, match=message):
        localizer.update(Answering(method, answer), None)
    assert localizer.update(PosteriorSamples(HERE), None).modes[0].weight > 0.5


def test_an_image_that_is_impossible_everywhere_on_a_first_step_is_lost_for_that_image_only():
    localizer = ParticleLocalizer(Oracle(Poses.identity(1), (0,), range(0)), SMALL, rng=np.random.default_rng(0))
    impossible = Answering("log_likelihood", lambda values: np.full(len(values), -np.inf))
    estimate = localizer.update(impossible, None)
    assert (estimate.status, estimate.log_evidence) == ("lost", -np.inf)
    estimate = localizer.update(PosteriorSamples(HERE), Odometry(Poses.identity(), GOOD))
    assert estimate.status == "converged"


def test_a_later_image_that_is_impossible_everywhere_leaves_its_own_samples_or_where_none_may_be_an_error():
    """Status lost, and the belief is where the image puts it; without a chance of a kidnap nothing is left at all."""
    impossible = Answering("log_likelihood", lambda values: np.full(len(values), -np.inf))
    localizer, truth, odometry = walking(5)
    estimate = localizer.update(impossible, odometry[3])
    assert (estimate.status, estimate.log_evidence) == ("lost", -np.inf)
    assert estimate.modes[0].world_from_camera.distance(Poses.identity())[0] < 0.2
    assert np.isfinite(localizer.step(image_of(4), odometry[4]).log_evidence)
    for nowhere_else in (replace(SMALL, recovery=RecoveryConfig(0.0, 0.0)), replace(SMALL, injection_fraction=0.0)):
        localizer, truth, odometry = walking(5)
        localizer.config = nowhere_else
        with pytest.raises(VaporTrackError, match="all 300 particle weights are zero"):
            localizer.update(impossible, odometry[3])
        assert localizer.step(image_of(3), odometry[3]).modes[0].world_from_camera.distance(truth[3])[0] < 0.3


def increment(rotation=None, translation=(0.0, 0.0, 0.0), covariance=GOOD):
    return Odometry(Poses(np.eye(3) if rotation is None else rotation, np.array(translation)), covariance)


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
    (Odometry(Poses.identity(2), GOOD), r"batch shape \(2,\), expected \(\)"),
]


@pytest.mark.parametrize(("odometry", "message"), BAD_ODOMETRY)
def test_odometry_that_is_none_is_refused_with_its_value_and_the_belief_stays(odometry, message):
    (localizer, _, walked), (untouched, _, _) = walking(4), walking(4)
    with pytest.raises(VaporTrackError, match=message):
        localizer.step(image_of(3), odometry)
    after, expected = localizer.step(image_of(3), walked[3]), untouched.step(image_of(3), walked[3])
    np.testing.assert_array_equal(after.particles.translation, expected.particles.translation)


def test_odometry_of_a_first_step_is_not_used_whatever_it_is():
    for odometry, _ in BAD_ODOMETRY:
        localizer, truth, _ = walking(1, num_before=0)
        estimate = localizer.step(image_of(0), odometry)
        assert estimate.modes[0].world_from_camera.distance(truth[0])[0] < 0.2


def test_a_rotation_in_single_precision_passes():
    rotation = Poses.exp(np.array([0.0, 0, 0, 0.3, -0.2, 1.1])).rotation.astype(np.float32).astype(np.float64)
    require_odometry(increment(rotation))


@pytest.mark.parametrize("covariance", [np.zeros((6, 6)), np.diag([1e-4, 0, 0, 0, 0, 0]), 1e-30 * np.eye(6)])
def test_a_singular_covariance_is_fine_as_the_jitter_keeps_kernels_apart(covariance):
    localizer, truth, odometry = walking(8)
    for i in range(3, 8):
        estimate = localizer.step(image_of(i), replace(odometry[i], covariance=covariance))
    assert estimate.modes[0].world_from_camera.distance(truth[7])[0] < 0.3
    assert np.isfinite(estimate.modes[0].covariance).all()


def test_a_singular_covariance_without_jitter_is_refused():
    localizer, _, _ = walking(3)
    localizer.config = replace(SMALL, kernels=KernelConfig(jitter_m=0.0, jitter_rad=0.0, smoothing=0.0))
    with pytest.raises(VaporTrackError, match=r"bandwidths must be positive, got 0\.0 m"):
        localizer.step(image_of(2), increment(covariance=np.zeros((6, 6))))


JUMP = Poses.exp(np.array([50.0, 0, 0, 0, 0, 0]))


def after_a_jump(odometry_of_jump, true_jump, num_frames=40):
    """Errors in metres and statuses from image 9 on of a walk whose odometry from image 9 to 10 is the given one."""
    localizer, truth, odometry = walking(num_frames, num_before=0)
    truth = Poses.stack([true_jump @ truth[i] if i >= 10 else truth[i] for i in range(num_frames)])
    localizer.model = Oracle(truth, (0,), range(0))
    error_m, statuses = [], []
    for i in range(num_frames):
        estimate = localizer.step(image_of(i), odometry_of_jump if i == 10 else odometry[i])
        mode = estimate.modes[0]
        assert np.isfinite([*mode.covariance.ravel(), mode.weight, estimate.log_evidence]).all()
        error_m.append(float(mode.world_from_camera.distance(truth[i])[0]))
        statuses.append(estimate.status)
    assert max(error_m[:10]) < 0.3
    return error_m[9:], statuses[9:]


@pytest.mark.parametrize("std_m", [0.005, 50.0])
def test_an_increment_of_50_m_that_is_wrong_moves_the_belief_away_and_images_bring_it_back(std_m):
    """It is a motion like any other: the belief leaves, the images fit it no more, and recovery returns. A covariance
    as wide does not spare that: one tempered image does not outweigh all places within 50 m."""
    covariance = np.diag([std_m**2] * 3 + [0.003**2] * 3)
    error_m, statuses = after_a_jump(Odometry(JUMP, covariance), Poses.identity())
    assert error_m[1] > 10.0
    assert statuses[1] != "converged"
    assert max(error_m[20:]) < 0.6
    assert statuses[-1] == "converged"


def test_an_increment_of_50_m_that_is_true_is_followed_though_the_heading_is_uncertain():
    error_m, statuses = after_a_jump(Odometry(JUMP, GOOD), JUMP)
    assert max(error_m) < 1.0  # a hundredth of a radian is half a metre over 50 m
    assert statuses[-1] == "converged"


def test_without_odometry_a_later_step_starts_anew_and_a_further_one_goes_on():
    localizer, truth, odometry = walking(8)
    for i in range(3, 8):
        estimate = localizer.step(image_of(i), None if i == 4 else odometry[i])
        assert estimate.modes[0].world_from_camera.distance(truth[i])[0] < 0.3
        if i == 4:
            assert estimate.effective_sample_size == pytest.approx(300)


def test_samples_and_weights_that_are_not_finite_make_no_posterior():
    poses = Poses.identity(3)
    poses.translation[1, 2] = np.nan
    with pytest.raises(VaporTrackError, match=r"kernel centre 1 of 3 is not finite: .*nan"):
        KernelDensity(poses, 0.1, 0.1)
    for bad in (np.nan, np.inf):
        with pytest.raises(VaporTrackError, match=f"log weight of kernel 0 of 2 is {bad}"):
            KernelDensity(Poses.identity(2), 0.1, 0.1, np.array([bad, 0.0]))


def test_a_likelihood_beyond_what_a_float_holds_gives_finite_weights():
    poses = Poses.identity(4)
    proposal = Proposal(poses, 2, np.zeros(4), np.zeros(4), np.zeros(4))
    for kidnap_probability in (0.0, 0.1):
        log_weights = mixture_log_weights(proposal, np.full(4, 900.0), kidnap_probability=kidnap_probability)
        np.testing.assert_allclose(log_weights, 0.0, atol=1e-12)
