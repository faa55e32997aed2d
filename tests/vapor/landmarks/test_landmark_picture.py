"""The landmarks of one image of a run, as its report shows them."""

import base64
from dataclasses import replace

import cv2
import numpy as np
import pytest

from filtering.measurement_noise import MeasurementNoise
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from sequences.writer import SequenceWriter
from tests.helpers.pages import ReadPage
from tests.helpers.sequence_files import BEGIN_NS
from tests.helpers.textured_room import CAMERA, walk
from vapor.landmarks.landmark_map import ViewCamera
from vapor.landmarks.localize import VerifiedPose, query_features
from vapor.landmarks.verify import Landmarks, LandmarkVerifier, ShownLandmarks, grey_view
from vapor.pipeline.config import RunConfig
from vapor.pipeline.model import load_model
from vapor.pipeline.run import VerifiedImages, run
from vapor.reporting.html.landmark_picture import landmark_caption, landmark_picture

SHARP = MeasurementNoise(noise_floor=(0.01,) * 3 + (0.003,) * 3, typical_std=(0.01,) * 3 + (0.003,) * 3)
SOMEWHERE = PosePosterior.from_estimates(Poses.identity(1), 0.3, 0.1, MeasurementNoise())


@pytest.mark.parametrize("k1", [0.0, -0.1])
def test_landmarks_are_shown_where_the_image_has_features(room, built, k1):
    """Through a lens that distorts, too, of which a map knows undistorted pixels."""
    camera = ViewCamera(CAMERA, k1)
    verifier = LandmarkVerifier(Landmarks(replace(built.landmarks, camera=camera)), SHARP)
    pose = walk(8, seed=5)[3]
    image = room.view(pose)
    of_image = query_features(grey_view(image, CAMERA)).pixels
    undistorted = camera.undistorted(of_image[:20])
    found = VerifiedPose(pose, np.eye(6), 20, undistorted, np.tile([0.0, 2.0], (20, 1)))
    shown = verifier.shown(image, CAMERA, [found, replace(found, inliers=15)], number=7)
    np.testing.assert_array_equal(shown.image, image)
    np.testing.assert_allclose(shown.features, of_image, atol=0.01)
    np.testing.assert_allclose(shown.seen, of_image[:20], atol=0.01)
    assert np.linalg.norm(shown.predicted - shown.seen, axis=1) == pytest.approx(2.0, rel=0.1)
    assert (shown.others, shown.number) == ((15,), 7)


def test_matches_that_are_elsewhere_than_the_pose_predicts_are_shown_apart(room, built):
    """From a pose that is off, hardly any match is where it must be; from the true one most are."""
    verifier, pose = LandmarkVerifier(Landmarks(built.landmarks), SHARP), walk(8, seed=5)[3]
    image = room.view(pose)
    (found, *_) = verifier.find(image, CAMERA, SOMEWHERE)
    beside = replace(found, world_from_camera=found.world_from_camera @ Poses.exp(np.array([0.5, 0, 0, 0, 0, 0])))
    right, wrong = (verifier.shown(image, CAMERA, [each]).disagreeing for each in (found, beside))
    assert len(wrong) > found.inliers / 2
    assert len(right) < len(wrong) / 2
    features = {tuple(each) for each in verifier.shown(image, CAMERA, [found]).features.round(3).tolist()}
    assert features >= {tuple(each) for each in wrong.round(3).tolist()}


def test_an_image_of_another_camera_is_shown_as_the_map_s_camera_sees_it(room, built):
    verifier, pose = LandmarkVerifier(Landmarks(built.landmarks), SHARP), walk(8, seed=5)[3]
    zoomed = replace(CAMERA.scaled(480, 360), fx=480.0, fy=480.0)
    image = room.view(pose, zoomed)
    shown = verifier.shown(image, zoomed, verifier.find(image, zoomed, SOMEWHERE))
    assert shown.image.shape == (CAMERA.height, CAMERA.width, 3)
    inside = (slice(40, 140), slice(50, 190))  # of what both see
    assert np.abs(shown.image[inside].astype(float) - room.view(pose)[inside]).mean() < 15.0
    np.testing.assert_allclose(shown.predicted, shown.seen, atol=3.0)


def test_the_picture_marks_features_landmarks_and_where_they_must_be():
    image = np.full((100, 160, 3), 128, np.uint8)
    at = np.array([[40.0, 50.0], [80.0, 20.0]])
    features = np.concatenate([at, [[120.0, 80.0], [20.0, 90.0]]])
    shown = ShownLandmarks(image, features, np.array([[120.0, 80.0]]), at, at + np.array([2.0, 0.0]), (31,), 4)
    picture = np.asarray(cv2.imdecode(np.frombuffer(landmark_picture(shown), np.uint8), cv2.IMREAD_COLOR)).astype(int)
    small = cv2.resize(picture.astype(np.float32), (160, 100), interpolation=cv2.INTER_AREA)
    blue, green, red = np.moveaxis(small, -1, 0)
    is_green, is_orange = (green > red + 30) & (green > blue + 30), (red > green + 15) & (green > blue + 10)
    apart = [np.linalg.norm(np.argwhere(is_green)[:, ::-1] - each, axis=1) for each in at]
    assert np.minimum(*apart).max() < 2.0
    assert all(each.min() < 2.0 for each in apart)
    for x, y in at.astype(int).tolist():  # five times as far as two pixels
        assert is_orange[y, x + 4 : x + 10].all()
        assert not is_orange[y, x + 12 :].any()
    assert small[90, 20].min() > 150.0
    assert red[80, 120] > max(green[80, 120], blue[80, 120]) + 100.0
    assert not (red > np.maximum(green, blue) + 100.0)[:70].any()
    said = landmark_caption(shown, 0.4)
    assert said.startswith("Image 4, at 0.4 s: of 4 features (grey) 3 match landmarks. 2 of these")
    assert "2.0 of 160 pixels off in the median" in said
    assert said.endswith("Another place is verified, by 31 landmarks.")


class _Verifier:
    """Verifies of each image what it is told, and shows which pose of which image is asked for."""

    latest = ()

    def shown(self, image, camera, found, *, which, number):
        return int(image[0, 0, 0]), number, which


class _Model:
    camera = None

    def __init__(self, found):
        self.verifier, self._found = _Verifier(), iter(found)

    def observe(self, image, *, rng):
        self.verifier.latest = next(self._found)
        return SOMEWHERE


def _observed(found):
    images, rng = VerifiedImages(_Model(found)), np.random.default_rng(0)
    buffer = np.zeros((4, 4, 3), np.uint8)
    for number in range(len(found)):
        buffer[:] = number  # as decoders do
        images.observe(buffer, rng=rng)
    return images


@pytest.mark.usefixtures("unchecked")
def test_the_image_in_the_middle_of_those_that_verify_a_place_is_shown_and_the_pose_that_was_believed():
    poses = [Poses(np.eye(3), np.array([x, 0.0, 0.0])) for x in (0.0, 5.0)]
    found = [VerifiedPose(pose, np.eye(6), 20, np.zeros((20, 2)), np.zeros((20, 2))) for pose in poses]
    images = _observed([(), *[found] * 150, *[()] * 49])
    assert len(images._kept.kept) < 8
    pixel, number, which = images.middle(Poses.stack([poses[1]] * 200))
    assert pixel == number
    assert abs(number - 75) <= 20
    assert which == 1
    assert _observed([(), ()]).middle(Poses.stack(poses)) is None


@pytest.mark.usefixtures("unchecked", "plain_results")
def test_a_run_with_landmarks_reports_a_picture_and_one_without_none(room, built, tiny_model, tmp_path):
    poses, path = walk(8, seed=5), tmp_path / "w.mcap"
    with SequenceWriter(path, camera=CAMERA, base_from_camera=Poses.identity(), metadata={}) as writer:
        for i in range(len(poses)):
            writer.write_odometry(BEGIN_NS + i * 10**8, poses[i], 1e-4 * np.eye(6))
            writer.write_image(BEGIN_NS + i * 10**8, room.view(poses[i]))
    config = RunConfig(num_samples=20, recording=False)
    model = load_model(str(tiny_model), config)
    run(path, model, tmp_path / "without", config)
    assert model.observation.is_verified(room.view(poses[3]), CAMERA) is None
    description = model.observation.description
    noise = replace(description.calibration.errors, verified=SHARP)
    calibration = replace(description.calibration, errors=noise)
    model.observation.description = replace(description, landmarks=Landmarks(built.landmarks), calibration=calibration)
    assert model.observation.is_verified(room.view(poses[3]), CAMERA)
    assert model.observation.is_verified(255 - room.view(poses[3]), CAMERA) is False
    result = run(path, model, tmp_path / "with", config)
    assert len(result.record.inliers) == 8
    assert result.record.inliers.min() >= 12
    shown = result.record.landmarks
    assert np.linalg.norm(shown.predicted - shown.seen, axis=1).max() < 3.1
    np.testing.assert_array_less(np.abs(shown.image.astype(int) - room.view(poses[shown.number])).mean(), 5.0)
    pages = [ReadPage.of((tmp_path / name / "report.html").read_text()) for name in ("without", "with")]
    assert ["Landmarks verified a place in 100 % of the images" in page.words for page in pages] == [False, True]
    assert landmark_caption(shown, shown.number * 0.1) in pages[1].words
    pictures = [[tag["src"] for name, tag in page.tags if name == "img" and tag.get("src")] for page in pages]
    data = base64.b64encode(landmark_picture(shown)).decode()
    assert [any(source.endswith(data) for source in sources) for sources in pictures] == [False, True]
