"""Places that landmarks verify err less, and in a way of their own, in filter, baseline and smoother."""

from dataclasses import replace

import numpy as np
import pytest

from filtering.config import LocalizerConfig
from filtering.errors import VaporTrackError
from filtering.hindsight import FilterStep
from filtering.kalman import KalmanLocalizer
from filtering.localizer import ParticleLocalizer
from filtering.mapped_views import MappedViews
from filtering.measurement_noise import MeasurementNoise
from filtering.motion import Odometry
from filtering.observation import Observation
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from filtering.smoothing import smooth

SHARP = MeasurementNoise(
    noise_floor=(0.01,) * 6, typical_std=(0.01,) * 6, degrees_of_freedom=10.0, length_m=0.3, correlated_fraction=0.8
)
ERRORS = MeasurementNoise(noise_floor=(0.3,) * 3 + (0.1,) * 3, typical_std=(0.3,) * 3 + (0.1,) * 3, verified=SHARP)
STEP = Odometry(Poses(np.eye(3), np.array([0.1, 0.0, 0.0])), np.diag([1e-5] * 6), 0.1)


def at(*x_m):
    return Poses(np.tile(np.eye(3), (len(x_m), 1, 1)), np.array([[x, 0.0, 0.0] for x in x_m]))


def seen(network=(), verified=(), weights=None):
    """What an image says: places that the network proposes, and verified ones, along x."""
    places = (*verified, *network)
    sharp = np.arange(len(places)) < len(verified)
    std = np.where(sharp[:, None], 0.01, np.array([0.3] * 3 + [0.1] * 3))
    covariances = std[:, :, None] ** 2 * np.eye(6)
    if weights is None:  # as sixty landmarks give them
        weights = np.where(sharp, 250.0, 1.0)
        weights = 0.95 * weights / weights.sum()
    return PosePosterior(at(*places), covariances, np.array(weights), ERRORS, at(*places), verified=sharp)


def localizer():
    return ParticleLocalizer(None, LocalizerConfig(), rng=np.random.default_rng(0))


def test_a_verified_image_makes_the_belief_as_sharp_as_it_is():
    filtering = localizer()
    coarse = filtering.update(seen([0.0]), None)
    assert coarse.modes[0].widest_std_m > 0.2
    assert coarse.status == "ambiguous"  # where it is, is known to a foot only
    sharp = filtering.update(seen([0.1], [0.1]), STEP)
    assert sharp.modes[0].widest_std_m < 0.03
    assert sharp.modes[0].world_from_camera.translation[0] == pytest.approx(0.1, abs=0.01)
    assert sharp.status == "converged"


def test_errors_of_the_network_are_not_those_of_landmarks():
    """The correlated error that coarse images show is not taken away from verified places."""
    filtering = localizer()
    filtering.update(seen([0.4], [0.0]), None)
    for k in range(1, 30):
        estimate = filtering.update(seen([0.1 * k + 0.4], [0.1 * k] if k % 5 == 0 else ()), STEP)
    assert estimate.modes[0].world_from_camera.translation[0] == pytest.approx(2.9, abs=0.03)


def test_being_sharp_is_no_evidence_for_a_place():
    """Two places alike, of which landmarks verify the wrong one only: neither wins."""
    filtering = localizer()
    estimate = filtering.update(seen([0.0], [50.0], weights=(0.45, 0.45)), None)
    for k in range(1, 100):
        estimate = filtering.update(seen([0.1 * k], [50.0 + 0.1 * k], weights=(0.45, 0.45)), STEP)
        assert estimate.status != "converged"
    weights = sorted(mode.weight for mode in estimate.modes)[-2:]
    assert weights[0] > 0.3


def test_beside_verified_places_another_counts_as_much_as_it_weighs():
    both = seen([0.0], [50.0], weights=(0.45, 0.45))
    assert both.possible[0] == pytest.approx(both.possible[1])
    hardly = seen([0.0], [50.0], weights=(0.96, 0.03))
    assert hardly.possible == pytest.approx([1.0, 0.03], abs=0.005)
    assert replace(hardly, verified=np.zeros(2, bool)).possible[1] > 0.3
    doubted = seen([0.0], [50.0], weights=(0.01, 0.9))
    assert doubted.possible == pytest.approx([0.222, 1.0], abs=0.005)


def test_a_part_that_is_there_once_is_recognised_within_few_views():
    filtering = localizer()
    filtering.update(seen([], [0.0, 50.0], weights=(0.47, 0.47)), None)
    for k in range(1, 20):
        estimate = filtering.update(seen([], [0.1 * k, 50.0 + 0.1 * k], weights=(0.47, 0.47)), STEP)
        assert estimate.status != "converged"
    for k in range(20, 50):
        estimate = filtering.update(seen([0.1 * k], [50.0 + 0.1 * k], weights=(0.96, 0.03)), STEP)
    assert estimate.status == "converged"
    assert estimate.modes[0].world_from_camera.translation[0] == pytest.approx(54.9, abs=0.1)


def test_the_kalman_filter_takes_verified_places_first():
    kalman = KalmanLocalizer()
    kalman.update(seen([0.0], [0.0]), None)
    for k in range(1, 10):
        mode = kalman.update(seen([0.1 * k + 0.2], [0.1 * k]), STEP)
    assert mode.world_from_camera.translation[0] == pytest.approx(0.9, abs=0.01)
    assert mode.widest_std_m < 0.02


def test_the_smoother_weighs_verified_places_by_their_own_errors():
    posteriors = [seen([0.1 * k + 0.3], [0.1 * k] if k in (0, 20) else ()) for k in range(21)]
    truth, filtering = at(*(0.1 * k for k in range(21))), localizer()
    observations = [Observation.of_posterior(each, STEP if k else None, 0.1) for k, each in enumerate(posteriors)]
    steps = [FilterStep.of(each, filtering.advance(each)) for each in observations]
    found = smooth(steps, ERRORS).best.poses
    assert np.abs(found.translation[:, 0] - truth.translation[:, 0]).max() < 0.05


def test_a_camera_that_sees_landmarks_later_gets_room_for_their_errors():
    filtering, kalman, plain = localizer(), KalmanLocalizer(), replace(ERRORS, verified=None)
    filtering.start_at(at(0.0)[0], 0.01 * np.eye(6), plain)
    kalman.update(PosePosterior.from_estimates(at(0.0), 0.3, 0.1, plain), None)
    for mode in (filtering.update(seen([0.1], [0.1]), STEP).modes[0], kalman.update(seen([0.1], [0.1]), STEP)):
        assert mode.world_from_camera.translation[0] == pytest.approx(0.1, abs=0.01)
        assert mode.widest_std_m < 0.03


def test_verified_places_need_their_errors():
    with pytest.raises(VaporTrackError, match="verified has shape"):
        replace(seen([0.0], [0.0]), noise=replace(ERRORS, verified=None))
    with pytest.raises(VaporTrackError, match="of their own"):
        replace(ERRORS, verified=ERRORS)


def test_inflating_and_splitting_keep_sources_apart():
    posterior = seen([0.0, 1.0], [0.0])
    larger = posterior.inflated(4.0, 9.0)
    np.testing.assert_allclose(larger.covariances[0], 9.0 * posterior.covariances[0])
    np.testing.assert_allclose(larger.covariances[1:], 4.0 * posterior.covariances[1:])
    np.testing.assert_allclose(larger.factors @ larger.factors, larger.covariances, atol=1e-12)
    assert larger.noise.verified == SHARP.inflated(9.0)
    assert posterior.of_source(1).noise == SHARP
    assert len(posterior.of_source(0).weights) == 2


def walked(mapped):
    """A camera leaves ground that the map shows; 2 m further on landmarks verify a place 50 m away, and no other."""
    filtering = localizer()
    filtering.update(seen([0.0], [0.0]), None)
    for k in range(1, 30):
        filtering.update(replace(seen([0.1 * k], [0.1 * k] if k < 10 else ()), mapped=mapped), STEP)
    for k in range(30, 40):
        estimate = filtering.update(replace(seen((), [50.0 + 0.1 * k]), mapped=mapped), STEP)
    return estimate.modes[0].world_from_camera.translation[0]


def test_look_alikes_do_not_take_over_where_the_map_cannot_show_the_place():
    shown = MappedViews(at(*np.arange(0.0, 1.0, 0.1), *np.arange(50.0, 60.0, 0.1)), 2.0, 0.5, 0.7)
    everywhere = replace(shown, poses=at(*np.arange(0.0, 60.0, 0.1)))
    assert walked(shown) == pytest.approx(3.9, abs=0.2)
    assert walked(everywhere) == pytest.approx(53.9, abs=0.2)


def test_a_belief_that_is_excused_is_not_taken_for_one_that_fits():
    mapped = MappedViews(at(50.0), 2.0, 0.5, 0.6)
    filtering = localizer()
    filtering.update(seen([0.0], [0.0]), None)
    for k in range(1, 10):
        estimate = filtering.update(replace(seen((), [50.0 + 0.1 * k]), mapped=mapped), STEP)
    assert estimate.modes[0].world_from_camera.translation[0] == pytest.approx(0.9, abs=0.1)
    assert estimate.agreement < 0.6
    assert estimate.status != "converged"


def test_views_are_mapped_as_far_as_they_resemble_those_of_the_map():
    mapped = MappedViews(at(0.0, 1.0), 2.0, 0.5, 0.8)
    np.testing.assert_allclose(mapped.distances(at(0.0, 2.0, -4.0)), [0.0, 0.5, 2.0])
    assert mapped.excuse(at(0.0, 2.0, -4.0)) == pytest.approx([0.0, 0.4, 0.8], abs=0.01)
    turned = Poses.exp(np.array([[0.0, 0.0, 0.0, 0.0, np.pi / 2, 0.0]]))
    assert mapped.distances(turned)[0] == pytest.approx(np.sqrt(2.0))
    rolled = Poses.exp(np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 1.0]]))  # an image that is turned shows the same
    assert mapped.distances(rolled)[0] == pytest.approx(0.0, abs=1e-9)


def test_what_is_mapped_is_asked_of_poses_of_a_base_as_well():
    base_from_camera = Poses.exp(np.array([0.3, -0.2, 0.5, 0.4, 0.1, -0.6]))
    cameras = Poses.exp(np.random.default_rng(0).normal(size=(5, 6)))
    mapped = MappedViews(at(0.0, 1.0), 2.0, 0.5, 0.8)
    bases = cameras @ base_from_camera.inverse()
    posterior = replace(seen([0.0], [0.0]), mapped=mapped).seen_from(base_from_camera)
    np.testing.assert_allclose(posterior.excuse(bases), mapped.excuse(cameras))
    assert not replace(seen([0.0]), mapped=mapped).excuse(cameras).any()
