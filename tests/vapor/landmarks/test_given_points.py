"""Landmarks at points of a reconstruction that was given."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import KDTree

from sequences.datasets.points import POINTS_OF_A_MODEL, SeenPoints
from tests.helpers.textured_room import CAMERA, walk
from vapor.landmarks.build import build, gather
from vapor.landmarks.features import Features
from vapor.landmarks.landmark_map import ViewCamera
from vapor.landmarks.points import seen
from vapor.landmarks.tracks import at_given_points, with_given_points
from vapor.landmarks.verify import grey_view

VIEW = ViewCamera(CAMERA)


def given_at(pixels: list[list[float]], point: list[int]) -> SeenPoints:
    return SeenPoints(np.array(point), VIEW.rays(np.array(pixels)))


def test_a_feature_shows_the_nearest_point_that_is_seen_within_a_pixel() -> None:
    features = Features(np.array([[10.0, 10], [30, 10], [50, 10], [70, 10]]), np.zeros((4, 2), np.float32))
    given = given_at([[10.9, 10], [9.8, 10], [30.9, 10], [51.1, 10], [70, 10], [30.2, 10]], [4, 5, 6, 7, 8, 8])
    # Of 4 and 5 the nearer; 6 is less than a pixel away, 7 is more; of both sightings of 8 the nearer counts.
    placed, points = at_given_points(features, given, VIEW)
    assert points.tolist() == [5, 6, -1, 8]
    np.testing.assert_allclose(placed.pixels[:, 0], [9.8, 30.9, 50, 70])
    placed, points = at_given_points(features, None, VIEW)
    assert placed is features
    assert points.tolist() == [-1] * 4
    none = Features(np.empty((0, 2)), np.empty((0, 2), np.float32))
    assert not len(at_given_points(none, given, VIEW)[1])


def test_features_of_one_point_match_and_features_of_two_do_not() -> None:
    points = [np.array([1, 2, -1]), np.array([2, 3, -1]), np.array([1, -1, 9])]
    before = {(0, 1): (np.array([0, 1, 2]), np.array([1, 0, 2]))}  # the first shows 1 and 3, the last neither
    found = {
        pair: [*zip(*(each.tolist() for each in both), strict=True)]
        for pair, both in with_given_points(before, points).items()
    }
    assert found == {(0, 1): [(1, 0), (2, 2)], (0, 2): [(0, 0)]}
    of_another_model = [points[0], points[1] + POINTS_OF_A_MODEL, points[2]]
    assert with_given_points(before, of_another_model)[0, 1][0].tolist() == [0, 1, 2]  # which say nothing of these
    nothing = [np.full(3, -1)] * 3
    assert with_given_points(before, nothing)[0, 1][0].tolist() == [0, 1, 2]
    assert with_given_points({}, nothing) == {}


@pytest.fixture(scope="module")
def given(material, built) -> dict[int, SeenPoints]:
    """What a model would say of the room that was made at full size: of its true points, a little off."""
    rng = np.random.default_rng(0)
    poses, shown = walk(60).inverse(), {}
    for image in range(60):
        found = seen(poses[np.full(len(built.points), image)], built.points)
        pixels = found.at * VIEW.focal + VIEW.centre + rng.normal(0.0, 0.2, (len(built.points), 2))
        inside = (found.in_camera[:, 2] > 0.1) & ((pixels > 0) & (pixels < (CAMERA.width, CAMERA.height))).all(axis=1)
        shown[image] = SeenPoints(np.flatnonzero(inside), VIEW.rays(pixels[inside]))
    return shown


def of_given_points(material, given: dict[int, SeenPoints], hidden=()):
    """Key images of which only given points match, none of those that are hidden."""
    placed = [
        at_given_points(features, None if number in hidden else given[image], VIEW)
        for number, (features, image) in enumerate(zip(material.features, material.key.tolist(), strict=True))
    ]
    matches = with_given_points({}, [points for _, points in placed])
    return replace(material, features=tuple(features for features, _ in placed), matches=matches)


def test_a_map_is_made_of_given_points_where_nothing_looks_alike(material, built, given) -> None:
    alone = build(of_given_points(material, given), VIEW)
    assert alone is not None
    assert len(alone.points) > 0.5 * len(built.points)
    off = np.minimum(np.abs(alone.points[:, 2] - 4.0), np.abs(alone.points[:, 0] - 2.0))
    assert np.median(off) < 0.02


def test_points_that_others_see_too_do_not_know_where_hidden_images_saw_them(material, given) -> None:
    hidden = np.zeros(len(material.key), bool)
    hidden[::3] = True
    whole = build(of_given_points(material, given), VIEW)
    never = build(of_given_points(material, given, np.flatnonzero(hidden).tolist()), VIEW)
    assert whole is not None
    assert never is not None
    left, alone = whole.hiding(hidden).points, never.points
    away, _ = KDTree(alone).query(left)
    assert len(left) > 0.8 * len(alone)
    assert np.median(away) < 1e-5
    before, _ = KDTree(alone).query(whole.points)
    assert np.median(before) > 1e-4


def test_given_points_are_joined_with_features_as_the_map_is_made(room, built, given) -> None:
    poses = walk(60)
    found = gather(
        lambda image: grey_view(room.view(poses[image]), CAMERA), poses, CAMERA, scale_m=1.0, given=given.get
    )
    assert found is not None
    both = build(found, VIEW)
    assert both is not None
    assert len(both.sightings) / len(both.points) > len(built.sightings) / len(built.points)
    off = np.minimum(np.abs(both.points[:, 2] - 4.0), np.abs(both.points[:, 0] - 2.0))
    assert np.median(off) < 0.02
