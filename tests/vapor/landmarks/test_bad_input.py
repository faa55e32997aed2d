"""Bad training images, poses, cameras and test images (synthetic): no landmarks, or errors as large as they are."""

from collections.abc import Iterator
from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.stats import f as fisher

from filtering.se3 import Poses
from tests.helpers.full import full, some
from tests.helpers.textured_room import CAMERA, Room, walk
from vapor.landmarks import build as building
from vapor.landmarks.build import build
from vapor.landmarks.landmark_map import ViewCamera
from vapor.landmarks.localize import LandmarkLocalizer
from vapor.landmarks.verify import grey_view
from vapor.training.landmarks import FoundLandmarks, find_landmarks
from vapor.training_data.training_set import TrainingSet

POSES, NEW = walk(60), walk(8, seed=5)


def views_of(room, poses):
    return np.stack([grey_view(room.view(poses[image]), CAMERA) for image in range(len(poses))])


@pytest.fixture(scope="module")
def views(room):
    return views_of(room, POSES)


@pytest.fixture(scope="module")
def new_views(room):
    return views_of(room, NEW)


def found_in(views, poses, *, camera=CAMERA, choice="stated", sequence=None):
    """What `train` finds, and what it says."""
    count = len(views)
    images = np.repeat(views[:, :1, :1, None], 3, axis=3)
    sequence = np.zeros(count, np.int64) if sequence is None else sequence
    size = camera.width, camera.height
    rows, none = np.arange(count), (None,) * count
    training = TrainingSet(
        images, rows, poses, sequence, ("a", "b"), size, rows, none, camera=camera, views=views, view_camera=camera
    )
    return find_landmarks(training, choice)


def first_poses(found: FoundLandmarks, views) -> Iterator:
    """Of each image that landmarks verify: its number, and the pose that most of them verify."""
    localizer = LandmarkLocalizer(found.built.landmarks)
    for number, view in enumerate(views):
        if verified := localizer.localize(localizer.features(view)):
            yield number, verified[0]


def errors_m(found, views, truth):
    return [float(pose.world_from_camera.distance(truth[i])[0]) for i, pose in first_poses(found, views)]


def beyond(found, views, truth):
    """Fraction of the verified images whose true pose is outside of the 99 % region of what is stated."""
    noise = found.verified.noise
    outside = []
    for number, pose in first_poses(found, views):
        away = pose.world_from_camera.between(truth[number]).log()
        squared = away @ np.linalg.solve(noise.covariance(pose.covariance[None])[0], away)
        outside.append(squared > 6.0 * fisher.ppf(0.99, 6, noise.degrees_of_freedom))
    return float(np.mean(outside)) if outside else 0.0


def off_by(poses, metres=0.0, radians=0.0):
    """Poses that each err on their own."""
    rng = np.random.default_rng(0)
    tangent = rng.standard_normal((len(poses), 6)) * np.repeat([metres, radians], 3) / np.sqrt(3.0)
    return poses @ Poses.exp(tangent)


def later(poses, count):
    """The pose of so many images later."""
    return poses[np.minimum(np.arange(len(poses)) + count, len(poses) - 1)]


def zoomed(factor):
    return replace(CAMERA, fx=factor * CAMERA.fx, fy=factor * CAMERA.fy)


def distorted(views, k1=0.2, k2=-0.1):
    """The views as a lens would show them."""
    down, across = np.mgrid[: CAMERA.height, : CAMERA.width]
    pixels = np.stack([across, down], axis=-1).reshape(-1, 2).astype(np.float64)
    at = ViewCamera(CAMERA, k1, k2).undistorted(pixels).astype(np.float32).reshape(*across.shape, 2)
    return np.stack([cv2.remap(view, at, None, cv2.INTER_LINEAR) for view in views])


def behind_a_crowd(views, fraction, px_an_image):
    """Four square patches of other rooms, which move over the views and cover so much of them."""
    rng, (height, width) = np.random.default_rng(0), views.shape[1:]
    side = round(np.sqrt(1.3 * fraction * height * width / 4))  # they overlap a little
    patches = [grey_view(Room(20 + k).view(POSES[7 * k]), CAMERA)[:side, :side] for k in range(4)]
    at, speed = rng.uniform(0.0, 1.0, (4, 2)) * views.shape[1:], rng.normal(0.0, px_an_image, (4, 2))
    crowded = views.copy()
    for number, view in enumerate(crowded):
        for patch, corner in zip(patches, (at + number * speed).astype(int), strict=True):
            rows, columns = (np.arange(patch.shape[axis]) + corner[axis] for axis in (0, 1))
            view[np.ix_(rows % height, columns % width)] = patch
    return crowded


def with_a_screen(views, shown):
    """A third of each view is a screen, on which another picture is in every image."""
    rng, (height, width) = np.random.default_rng(0), views.shape[1:]
    filled = views.copy()
    for view in filled:
        picture = shown[rng.integers(len(shown))]
        view[height // 5 : 4 * height // 5, width // 4 : 4 * width // 5] = cv2.resize(
            picture, (4 * width // 5 - width // 4, 4 * height // 5 - height // 5)
        )
    return filled


def of_two_scales():
    """The poses, every other one of a recording whose lengths are doubled."""
    scale = np.where(np.arange(len(POSES)) % 2, 2.0, 1.0)
    return Poses(POSES.rotation, scale[:, None] * POSES.translation)


@pytest.mark.parametrize(
    ("poses", "camera", "taken"),
    some(
        1,
        [
            pytest.param(off_by(POSES, metres=0.1), CAMERA, np.asarray, id="10 cm each"),
            pytest.param(POSES, zoomed(1.3), np.asarray, id="another camera's focal length"),
            pytest.param(later(POSES, 1), CAMERA, np.asarray, id="an image late"),
            pytest.param(of_two_scales(), CAMERA, np.asarray, id="two scales"),
            pytest.param(POSES, CAMERA, distorted, id="distortion that is not stated"),
        ],
    ),
)
def test_landmarks_by_poses_and_cameras_that_are_wrong_are_coarse(views, new_views, poses, camera, taken):
    found, _ = found_in(taken(views), poses, camera=camera)
    new = taken(new_views)
    errors = errors_m(found, new, NEW)
    assert np.median(errors) > 0.05
    assert beyond(found, new, NEW) == 0.0


@full
def test_poses_that_each_err_by_10_degrees_give_no_landmarks(views):
    found, notes = found_in(views, off_by(POSES, radians=np.deg2rad(10.0)), choice="auto")
    assert found is None
    assert len(notes) == 1  # nothing of a camera, which cannot be found by such poses
    assert "hardly any point is seen where it must be by the poses" in notes[0]


def no_map(views, poses):
    material = building.gather(lambda image: views[image], poses, CAMERA, scale_m=1.0)
    return material is None or build(material, ViewCamera(CAMERA)) is None


@full
def test_poses_that_are_late_by_much_give_no_landmarks(views):
    assert no_map(views[::2], later(POSES, 8)[::2])
    assert not no_map(views[::2], POSES[::2])


@full
def test_distortion_that_is_not_stated_is_found(views):
    bent, poses = distorted(views[::2]), POSES[::2]
    material = building.gather(lambda image: bent[image], poses, CAMERA, scale_m=1.0)
    found = building.camera_found(material, ViewCamera(CAMERA)).camera
    assert found.camera.fx == pytest.approx(CAMERA.fx, rel=0.01)
    edge = np.array([[0.0, 0.5 * CAMERA.height]])
    np.testing.assert_allclose(found.undistorted(edge), ViewCamera(CAMERA, 0.2, -0.1).undistorted(edge), atol=1.0)


def test_too_few_images_to_tell_how_poses_err_give_no_landmarks(views):
    found, notes = found_in(views[::4], POSES[::4])
    assert found is None
    assert "how poses err is found on 20 or more" in notes[0]


def test_a_crowd_or_a_screen_before_the_camera_leaves_what_is_seen_beside_it_right(built, new_views):
    others = views_of(Room(7), NEW)
    for bad in (behind_a_crowd(new_views, 0.6, 25.0), with_a_screen(new_views, others)):
        localizer = LandmarkLocalizer(built.landmarks)
        found = [localizer.localize(localizer.features(view)) for view in bad]
        assert sum(map(bool, found)) >= len(bad) / 2
        for number, poses in enumerate(found):
            assert all(each.world_from_camera.distance(NEW[number])[0] < 0.1 for each in poses)


@full
def test_a_crowd_among_the_training_images_costs_points_and_a_dense_one_all_of_them(views, new_views):
    found, _ = found_in(behind_a_crowd(views, 0.6, 0.5), POSES)
    assert max(errors_m(found, new_views, NEW)) < 0.03
    assert beyond(found, new_views, NEW) == 0.0
    assert no_map(behind_a_crowd(views, 0.6, 8.0)[::2], POSES[::2])


def test_a_map_stays_within_its_memory_and_keeps_what_most_images_show(monkeypatch, material, built):
    def size(found):
        m = found.landmarks
        return m.points.nbytes + m.descriptors.nbytes + m.shown.nbytes

    assert size(built) <= building._MOST_BYTES * len(material.key)
    for name, most in (("_MOST_BYTES_OF_ALL", 60_000), ("_MOST_BYTES", 60_000 // len(material.key))):
        with monkeypatch.context() as patched:
            patched.setattr(building, name, most)
            small = build(material, ViewCamera(CAMERA))
        assert 50_000 < size(small) <= 60_000
        views = np.bincount(small.landmarks.shown)
        assert np.median(views) > np.median(np.bincount(built.landmarks.shown))
        localizer = LandmarkLocalizer(small.landmarks)
        assert len(localizer.landmarks.points) < len(built.points) / 2
