"""Images are localized by landmarks, and posteriors become sharp where these are seen."""

from dataclasses import replace

import numpy as np
import pytest

from filtering.mapped_views import MOST_ELSEWHERE
from filtering.measurement_noise import MeasurementNoise
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from tests.helpers.textured_room import CAMERA, Room, walk
from vapor.calibration.error_correlation import Travel
from vapor.calibration.verification import SeenPlaces, evidence, fit_reach, fit_verification, none_right
from vapor.calibration.verified_errors import LeaveOut, fit_verified_errors, leave_out
from vapor.landmarks.build import build
from vapor.landmarks.features import Features, restored
from vapor.landmarks.landmark_map import ViewCamera
from vapor.landmarks.localize import LandmarkLocalizer, VerifiedPose
from vapor.landmarks.verify import Landmarks, LandmarkVerifier, Verification, grey_view, verified

SHARP = MeasurementNoise(noise_floor=(0.01,) * 3 + (0.003,) * 3, typical_std=(0.01,) * 3 + (0.003,) * 3)
ERRORS = MeasurementNoise(noise_floor=(0.3,) * 3 + (0.1,) * 3, typical_std=(0.3,) * 3 + (0.1,) * 3, verified=SHARP)
POSE = walk(8, seed=5)[3]


def coarse(*x_m, weights=None):
    """What a network says: places along x."""
    poses = Poses(np.tile(np.eye(3), (len(x_m), 1, 1)), np.array([[x, 0.0, 0.0] for x in x_m]))
    return PosePosterior.from_estimates(poses, 0.3, 0.1, ERRORS, weights=weights)


def found_at(x_m, inliers=50):
    pose = Poses(np.eye(3), np.array([x_m, 0.0, 0.0]))
    return VerifiedPose(pose, 1e-6 * np.eye(6), inliers, np.zeros((inliers, 2)), np.zeros((inliers, 2)))


@pytest.fixture(scope="module")
def verifier(built):
    return LandmarkVerifier(Landmarks(built.landmarks), SHARP)


def test_new_views_are_localized_within_centimetres(room, verifier):
    for pose in walk(8, seed=5):
        (first, *_) = verifier.find(room.view(pose), CAMERA, coarse(0.0))
        metres, radians = first.world_from_camera.distance(pose)
        assert metres < 0.03
        assert radians < 0.01
        assert first.inliers >= 12


@pytest.mark.parametrize("factor", [0.7, 2.0])
def test_images_of_another_size_or_camera_are_brought_to_the_map_s(room, verifier, factor):
    larger = CAMERA.scaled(round(factor * CAMERA.width), round(factor * CAMERA.height))
    zoomed = replace(CAMERA, fx=1.2 * CAMERA.fx, fy=1.2 * CAMERA.fy)
    for camera in (larger, zoomed):
        (first, *_) = verifier.find(room.view(POSE, camera), camera, coarse(0.0))
        assert first.world_from_camera.distance(POSE)[0] < 0.05


def test_images_that_show_nothing_of_the_place_verify_nothing(room, verifier):
    rng, shape = np.random.default_rng(0), (CAMERA.height, CAMERA.width, 3)
    moved = np.asarray(room.view(POSE), np.float32)
    blurred = sum(np.roll(moved, shift, axis=1) for shift in range(60)) / 60.0
    for image in (
        np.zeros(shape, np.uint8),
        np.full(shape, 255, np.uint8),
        rng.integers(0, 256, shape, dtype=np.uint8),
        Room(7).view(POSE),
        blurred.astype(np.uint8),
    ):
        posterior = coarse(0.0)
        assert verifier.verify(image, CAMERA, posterior) is posterior, image.mean()
        assert verifier.latest == []


def test_a_verified_place_is_sharp_and_one_that_is_not_stays_coarse():
    posterior = verified(coarse(0.0, 5.0), [found_at(0.1)], Verification())
    assert posterior.verified.tolist() == [True, False, False]
    np.testing.assert_allclose(np.diag(posterior.covariances[0])[:3], 1e-4 + SHARP.spread * 1e-6)
    np.testing.assert_allclose(np.diag(posterior.covariances[1])[:3], 0.09)
    assert posterior.weights[0] > 0.9
    assert posterior.weights.sum() < 1.0  # it may be nowhere here


def test_two_verified_places_have_the_weights_that_the_network_gives_them():
    network = coarse(0.0, 5.0, weights=np.array([0.3, 0.7]))
    posterior = verified(network, [found_at(0.0, 60), found_at(5.0, 54)], Verification(power=1.0, unproposed=1e-6))
    first, second = posterior.weights[:2]
    assert first / second == pytest.approx(0.3 * 60 / (0.7 * 54), rel=1e-3)


def test_a_verified_place_that_the_network_did_not_propose_is_added():
    posterior = verified(coarse(0.0), [found_at(20.0)], Verification())
    assert posterior.means.translation[:, 0].tolist() == [20.0, 0.0]
    assert posterior.weights[0] > posterior.weights[1]


def test_landmarks_of_the_place_say_that_an_image_is_not_foreign():
    network = replace(coarse(0.0), ood_score=3.0)
    assert network.is_out_of_distribution
    assert not verified(network, [found_at(0.0)], Verification()).is_out_of_distribution
    assert verified(network, [], Verification()) is network


def test_errors_are_found_on_images_without_those_near_them_in_time(built):
    told = []
    left_out = leave_out(built, advance=lambda done, total: told.append((done, total)))
    assert told == [(done, len(left_out.found)) for done in range(1, len(left_out.found) + 1)]
    assert left_out.verified > 0.5
    found = fit_verified_errors(left_out, -6.0)
    assert found.images >= 20
    assert found.elsewhere == 0.0
    assert found.median_m < 0.03
    assert found.coverage[2] > 0.85
    assert max(found.noise.typical_std[:3]) < 0.03
    none = replace(left_out, found=((),) * len(left_out.found))
    assert fit_verified_errors(none, -6.0) is None


def test_regions_hold_the_left_out_images_though_most_are_exact_and_some_are_far_off():
    """As where recordings do not agree: no part of the images of the right place is taken for outliers."""
    rng = np.random.default_rng(0)
    poses = walk(100)
    away = 0.001 * rng.standard_normal((100, 6))
    away[::3] += rng.uniform(-0.5, 0.5, (34, 6)) * np.repeat([1.0, 0.2], 3)
    found = tuple((replace(found_at(0.0), world_from_camera=poses[i] @ Poses.exp(away[i])),) for i in range(100))
    left_out = LeaveOut(Travel.along(poses, np.zeros(100, int)), found, poses, np.zeros(100), 2.0)
    found = fit_verified_errors(left_out, -6.0)
    assert len(left_out.right) == 100
    assert found.coverage[1] >= 0.9


def test_what_a_verified_place_is_worth_follows_from_held_out_images():
    """Where landmarks verify the wrong of two places as often, they are worth less; the network then decides."""

    def seen(right):
        inliers = np.array([60.0, 50.0]) if right else np.array([50.0, 60.0])
        return SeenPlaces(inliers, np.array([0.5, 0.5]), np.array([True, False]), 1.0, 0.5)

    before = Verification(reach=0.7, elsewhere=0.3)
    always = fit_verification([seen(True)] * 200, 200.0, before)
    half = fit_verification([seen(True), seen(False)] * 100, 200.0, before)
    assert always.power > half.power
    assert (always.reach, always.elsewhere) == (0.7, 0.3)
    assert fit_verification([], 1.0, before) == before
    outside = SeenPlaces(np.array([12.0]), np.array([0.0]), np.array([False]), 1.0, 1.0)
    assert fit_verification([outside] * 200, 200.0, before).gain < Verification().gain / 2


def test_where_landmarks_reach_is_found_on_images_at_all_distances():
    """Right up to 0.8 depths, and a place 20 m off is verified in every fifth image, in every second, or in none."""
    distance = np.linspace(0.05, 2.0, 400)
    truth = Poses(np.tile(np.eye(3), (400, 1, 1)), np.zeros((400, 3)))
    travel = Travel.along(truth, np.zeros(400, int))

    def left_out(every):
        alike = [(found_at(20.0),) if every and i % every == 0 else () for i in range(400)]
        found = tuple((found_at(0.0), *alike[i]) if distance[i] < 0.8 else alike[i] for i in range(400))
        return LeaveOut(travel, found, truth, distance, 2.0)

    alike, more, alone = (fit_reach(left_out(every), 400.0) for every in (5, 2, 0))
    assert alike.reach == alone.reach == pytest.approx(0.8, rel=0.1)
    assert alike.elsewhere == pytest.approx(0.2, abs=0.03)
    assert more.elsewhere == MOST_ELSEWHERE
    assert alone.elsewhere < 0.01
    assert fit_reach(left_out(2), 1.0).elsewhere < 0.15  # one image's worth says little
    none = fit_reach(LeaveOut(travel, (), truth[:0], distance[:0], 2.0), 0.0)
    assert none.reach == pytest.approx(Verification().reach, rel=0.1)
    assert none.elsewhere == Verification().elsewhere


def test_how_often_all_verified_places_are_wrong_is_found_with_caution():
    def seen(right):
        return SeenPlaces(np.array([50.0]), np.array([0.5]), np.array([right]), 1.0, 0.5)

    few, many = ([seen(True)] * count for count in (5, 500))
    assert none_right([], 1.0) == pytest.approx(0.05)
    assert none_right(many, 500.0) < none_right(few, 5.0) < 0.05
    assert none_right([seen(True), seen(False)] * 50, 100.0) == pytest.approx(0.46, abs=0.01)
    said = evidence([seen(True), seen(False)], Verification(), MeasurementNoise(outlier_probability=0.1))
    assert said[0] > np.log(0.8)
    assert said[1] == pytest.approx(np.log(0.1), abs=0.05)  # another place of the network may be the true one


def two_rooms(built):
    """The room twice, the second 20 m away, with summaries by which no image is like its own room."""
    m = built.landmarks
    count, shift = len(m.points), np.array([20.0, 0.0, 0.0], np.float32)
    rng = np.random.default_rng(0)
    return replace(
        m,
        points=np.concatenate([m.points, m.points + shift]),
        descriptors=np.concatenate([m.descriptors, m.descriptors]),
        rotation=np.concatenate([m.rotation, m.rotation]),
        translation=np.concatenate([m.translation, m.translation + shift]),
        begins=np.concatenate([m.begins, m.begins[1:] + m.begins[-1]]),
        shown=np.concatenate([m.shown, m.shown + count]).astype(np.int32),
        summaries=rng.standard_normal((2 * len(m.summaries), m.summaries.shape[1])).astype(np.float32),
    )


def test_all_places_that_a_network_proposes_are_looked_at(room, built):
    """What looks alike comes from chance here; each of two places alike is verified because it is proposed."""
    localizer = LandmarkLocalizer(two_rooms(built))
    other = Poses(POSE.rotation, POSE.translation + np.array([20.0, 0.0, 0.0]))
    features = localizer.features(grey_view(room.view(POSE), CAMERA))
    found = localizer.localize(features, Poses.stack([other, POSE]))
    assert len(found) == 2
    for place in (POSE, other):
        assert min(float(each.world_from_camera.distance(place)[0]) for each in found) < 0.03


def test_points_in_one_place_tell_no_pose(built):
    """A blob far off: whatever the solver makes of it, no exception, and no pose as sharp as none is."""
    m = built.landmarks
    blob = replace(m, points=np.tile(np.array([0.0, 0.0, 3.0], np.float32), (len(m.points), 1)))
    rng = np.random.default_rng(0)
    for spread in (1e-6, 1e-4, 1e-2):
        near = replace(blob, points=blob.points + spread * rng.standard_normal(blob.points.shape).astype(np.float32))
        localizer = LandmarkLocalizer(near)
        descriptors = restored(m.descriptors[m.shown_by(0)[:200]])
        features = Features(rng.normal(100.0, 1.0, (len(descriptors), 2)), descriptors)
        for each in localizer.localize(features):
            assert np.isfinite(each.covariance).all()


@pytest.mark.parametrize("stated", [None, replace(CAMERA, fx=1.1 * CAMERA.fx, fy=1.1 * CAMERA.fy)])
def test_intrinsics_that_were_missing_or_wrong_in_training_do_no_harm(room, material, stated):
    """The map's camera is the fitted one; images of known intrinsics are resampled to it."""
    found = build(replace(material, stated=stated), ViewCamera(CAMERA))
    assert found.landmarks.stated == stated
    for camera in (stated, CAMERA, None):
        (first, *_) = LandmarkVerifier(Landmarks(found.landmarks), SHARP).find(room.view(POSE), camera, coarse(0.0))
        assert first.world_from_camera.distance(POSE)[0] < 0.04


def test_errors_of_verified_places_are_added_where_a_posterior_has_none(room, verifier):
    plain = PosePosterior.from_estimates(Poses.stack([POSE]), 0.3, 0.1, replace(ERRORS, verified=None))
    posterior = verifier.verify(room.view(POSE), CAMERA, plain)
    assert posterior.verified.tolist() == [True, False]
    assert posterior.noise.verified == SHARP
