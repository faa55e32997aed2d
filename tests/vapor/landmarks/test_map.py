"""The map of landmarks: where points are, which camera took the images, and what is left out of it."""

from dataclasses import replace

import numpy as np
import pytest

from filtering.se3 import Poses
from tests.helpers.full import some
from tests.helpers.textured_room import CAMERA, Room, walk
from vapor.landmarks.build import build, camera_found, gather
from vapor.landmarks.features import mutual_matches, mutual_matches_among, within
from vapor.landmarks.landmark_map import ViewCamera
from vapor.landmarks.localize import LandmarkLocalizer
from vapor.landmarks.points import Sightings, parallax, seen, triangulated
from vapor.landmarks.tracks import find_sightings
from vapor.landmarks.verify import grey_view


def test_points_are_where_rays_meet():
    rng = np.random.default_rng(0)
    points, poses = rng.uniform([-1, -1, 3], [1, 1, 6], (20, 3)), walk(5).inverse()
    view, point = (each.ravel() for each in np.indices((5, 20)))
    rays = seen(poses[view], points[point]).at
    of = Sightings(view, point, np.arange(100), rays)
    np.testing.assert_allclose(triangulated(poses, rays, of), points, atol=1e-5)
    centres = poses.inverse().translation
    towards = points[0] - centres
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    widest = np.arccos((towards @ towards.T).min())
    assert 0.5 * widest < parallax(poses, points, of)[0] < 2.0 * widest


def test_matches_are_mutual_and_clearly_nearest():
    one = np.eye(4, dtype=np.float32)
    other = one[[2, 0, 0]]  # the first has two equal partners, the second none
    first, second = mutual_matches(one, other, 0.9)
    assert (first.tolist(), second.tolist()) == ([2], [0])
    assert not len(mutual_matches(one[:0], other, 0.9)[0])
    assert mutual_matches(one, other[:1], 0.9)[0].tolist() == [2]


def test_matches_among_pairs_of_near_pixels_are_the_likest_of_both():
    rng = np.random.default_rng(0)
    one, other = rng.uniform(0, 30, (40, 2)), rng.uniform(0, 30, (60, 2))
    i, j = within(one, other, 5.0)
    near = np.abs(one[:, None] - other).max(axis=2) <= 5.0
    assert sorted(zip(i, j, strict=True)) == [tuple(pair) for pair in np.argwhere(near)]
    likeness = np.where(near, rng.uniform(size=near.shape), -1.0).astype(np.float32)
    nearest = likeness.argmax(axis=1)
    mutual = (likeness.argmax(axis=0)[nearest] == np.arange(40)) & near.any(axis=1)
    first, second = mutual_matches_among(likeness[i, j], i, j)
    assert (first.tolist(), second.tolist()) == (np.flatnonzero(mutual).tolist(), nearest[mutual].tolist())
    assert 10 < len(first) < 40
    assert not len(mutual_matches_among(likeness[:0, 0], i[:0], j[:0])[0])
    assert not len(within(one, other[:0], 5.0)[0])


def test_distortion_is_taken_away():
    camera = ViewCamera(CAMERA, -0.2, 0.05)
    rays = np.random.default_rng(0).uniform(-0.5, 0.5, (50, 2))
    squared = np.square(rays).sum(axis=1, keepdims=True)
    pixels = camera.focal * rays * (1 - 0.2 * squared + 0.05 * squared**2) + camera.centre
    np.testing.assert_allclose(camera.rays(pixels), rays, atol=1e-6)


def test_points_of_the_map_lie_on_the_walls(built):
    points = built.points
    ahead, right = np.abs(points[:, 2] - 4.0), np.abs(points[:, 0] - 2.0)
    assert len(points) > 300
    assert np.median(np.minimum(ahead, right)) < 0.02
    assert built.agreeing > 0.8
    assert 1.5 < built.material.depth_m < 5.0


def test_nothing_depends_on_the_unit_of_length(room, built):
    poses = walk(60)
    larger = Poses(poses.rotation, 30.0 * poses.translation)
    found = gather(lambda image: grey_view(room.view(poses[image]), CAMERA), larger, CAMERA, scale_m=30.0)
    again = build(found, ViewCamera(CAMERA))
    assert found.key.tolist() == built.material.key.tolist()
    assert found.depth_m == pytest.approx(30.0 * built.material.depth_m)
    assert len(again.points) == pytest.approx(len(built.points), rel=0.02)


@pytest.mark.parametrize("factor", some(1, [0.85, 1.2]))
def test_a_wrong_focal_length_is_found(material, factor):
    wrong = replace(CAMERA, fx=factor * CAMERA.fx, fy=factor * CAMERA.fy)
    found = camera_found(material, ViewCamera(wrong))
    assert found.camera.camera.fx == pytest.approx(CAMERA.fx, rel=0.02)
    assert np.median(found.errors) < 0.5


def test_what_is_hidden_leaves_no_point_that_others_do_not_show(built):
    hidden = np.arange(len(built.material.key)) < len(built.material.key) // 2
    left = built.hiding(hidden)
    assert len(left.poses) == (~hidden).sum()
    assert len(left.points) < len(built.points)
    views = np.bincount(left.shown, minlength=len(left.points))
    assert views.min() >= 2
    ahead, right = np.abs(left.points[:, 2] - 4.0), np.abs(left.points[:, 0] - 2.0)
    assert np.median(np.minimum(ahead, right)) < 0.03


def _gathered(view, poses):
    return gather(view, poses, CAMERA, scale_m=1.0)


def test_without_texture_or_parallax_there_is_no_map(room):
    poses, turned = walk(20), walk(20, moves=False)
    white = np.full((CAMERA.height, CAMERA.width), 255, np.uint8)
    assert _gathered(lambda image: white, poses) is None
    assert _gathered(lambda image: grey_view(room.view(turned[image]), CAMERA), turned) is None
    assert _gathered(lambda image: grey_view(room.view(poses[image]), CAMERA), poses[:1]) is None


def test_poses_that_have_nothing_to_do_with_the_images_give_no_map(room):
    poses, others = walk(20), walk(20, seed=3)
    rooms = [Room(seed) for seed in range(20)]
    mirrored = Poses(np.swapaxes(others.rotation, 1, 2), others.translation)
    for view, stated in (
        (lambda image: grey_view(rooms[image].view(poses[image]), CAMERA), poses),  # of another place each
        (lambda image: grey_view(room.view(poses[0]), CAMERA), poses),  # all alike
        (lambda image: grey_view(room.view(others[image]), CAMERA), mirrored),
    ):
        material = _gathered(view, stated)
        assert material is None or build(material, ViewCamera(CAMERA)) is None


def test_two_storeys_that_look_alike_share_no_point(material):
    """Rays of what is the same on both, one above the other, are parallel."""
    count = len(material.key)
    above = Poses(material.poses.rotation, material.poses.translation + np.array([0.0, 3.0, 0.0]))
    poses = Poses.concatenate([material.poses, above])
    matches = {(i, i + count): (np.arange(len(f)),) * 2 for i, f in enumerate(material.features)}
    features = (*material.features, *material.features)
    found, errors = find_sightings(poses, features, ViewCamera(CAMERA), matches, depth_m=material.depth_m, most_px=4.0)
    assert len(found) == 0
    assert np.isinf(errors).all()


def test_what_is_ignored_is_not_looked_for(room, built):
    localizer, pose = LandmarkLocalizer(built.landmarks), walk(8, seed=5)[3]
    features = localizer.features(grey_view(room.view(pose), CAMERA))
    assert localizer.localize(features, Poses.stack([pose]))
    nothing = localizer.ignoring(np.ones(len(built.landmarks.poses), bool))
    assert not nothing.localize(features, Poses.stack([pose]))
    assert np.isinf(nothing.view_distances(pose)).all()
