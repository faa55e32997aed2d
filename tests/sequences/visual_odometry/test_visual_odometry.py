"""Visual odometry on images of textured boards whose poses are known."""

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from filtering.errors import VaporTrackError
from filtering.motion import Odometry
from filtering.se3 import Poses
from sequences.datasets.frames import posed_frames
from sequences.visual_odometry.odometry import VisualOdometry
from tests.helpers.boards import CAMERA, ROOM, STEP_NS, Board, Room, images_of, walk


def followed(images):
    visual = VisualOdometry(CAMERA)
    return [visual.step(image, STEP_NS * i) for i, image in enumerate(images)]


def whole(motions):
    """Consecutive motions as one."""
    result = Odometry.still()
    for motion in motions:
        assert motion is not None
        result = result.then(motion)
    return result


def in_metres(motion, unit):
    """A motion whose unit of length is known."""
    to = np.diag([unit] * 3 + [1.0] * 3)
    moved = Poses.exp(to @ motion.previous_from_current.log())
    return Odometry(moved, to @ motion.covariance @ to, motion.duration_s)


def test_a_walk_is_followed_in_a_unit_of_its_own():
    true, motions = walk("sideways"), followed(images_of(walk("sideways")))
    assert motions[0] is None
    parts = [(i, i + 15) for i in range(15, 90, 15)]
    found = [whole(motions[a + 1 : b + 1]) for a, b in parts]
    real = [true[a].inverse() @ true[b] for a, b in parts]
    lengths = np.array([np.linalg.norm(each.translation) for each in real])
    units = lengths / [np.linalg.norm(each.previous_from_current.translation) for each in found]
    assert np.log(units).std() < 0.1
    for motion, expected in zip(found, real, strict=True):
        error = motion.previous_from_current.between(expected).log()
        direction = motion.previous_from_current.translation @ expected.translation
        direction /= np.linalg.norm(motion.previous_from_current.translation) * np.linalg.norm(expected.translation)
        assert np.linalg.norm(error[3:]) < np.radians(1.0)
        assert np.degrees(np.arccos(direction)) < 10.0
    assert 1.0 < np.median(units) < 2.5  # the boards are 2 to 4 m away, and two are taken for usual


@pytest.mark.parametrize("kind", ["sideways", "turning", "standing"])
def test_motions_err_by_no_more_than_their_covariances_state(kind):
    true, squared = walk(kind), []
    motions = followed(images_of(true))
    for a in range(10, 85, 5):
        motion, real = whole(motions[a + 1 : a + 6]), true[a].inverse() @ true[a + 5]
        length = np.linalg.norm(motion.previous_from_current.translation)
        unit = np.linalg.norm(real.translation) / length if kind == "sideways" else 1.0
        metric = in_metres(motion, unit)
        error = metric.previous_from_current.between(real).log()
        squared.append(error @ np.linalg.solve(metric.covariance, error))
        assert (np.sqrt(np.diag(metric.covariance)) < [0.03] * 3 + [0.006] * 3).all()
    assert np.mean(squared) < 6.0


def test_the_unit_follows_from_how_far_away_the_scene_usually_is():
    """The same images, as if of a table or of a square."""
    images = images_of(walk("sideways", 20))
    near, far = VisualOdometry(CAMERA), VisualOdometry(CAMERA, usual_depth_m=60.0)
    for i, image in enumerate(images):
        one, other = near.step(image, STEP_NS * i), far.step(image, STEP_NS * i)
    scaled = in_metres(one, 30.0)
    np.testing.assert_allclose(other.previous_from_current.translation, 30 * one.previous_from_current.translation)
    np.testing.assert_allclose(other.covariance, scaled.covariance, rtol=1e-9)
    for depth in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(VaporTrackError, match="usual_depth_m is"):
            VisualOdometry(CAMERA, usual_depth_m=depth)


def test_standing_is_no_motion():
    motion = whole(followed(images_of(walk("standing", 60)))[1:])
    assert np.linalg.norm(motion.previous_from_current.translation) < 0.02
    assert np.degrees(np.linalg.norm(motion.previous_from_current.log()[3:])) < 0.3


def test_a_turn_on_the_spot_shows_no_way():
    true = walk("turning", 60)
    motion, real = whole(followed(images_of(true))[1:]), true[0].inverse() @ true[60]
    error = motion.previous_from_current.between(real).log()
    std = np.sqrt(np.diag(motion.covariance))
    assert np.degrees(np.linalg.norm(error[3:])) < 1.0
    assert (np.abs(error) < 4.0 * std).all()


def test_something_large_that_moves_widens_the_motion_rather_than_bends_it():
    room = Room((*ROOM.boards, Board((-1.0, -0.8), 1.6, (1.1, 1.6), 9)))
    true = walk("sideways", 60)
    crowd = followed(images_of(true, room=room, moved=lambda i: (0.0,) * 4 + (0.02 * i,)))
    quiet = followed(images_of(true, room=room))
    for a in range(20, 55, 5):
        motion, real = whole(crowd[a + 1 : a + 6]), true[a].inverse() @ true[a + 5]
        error = motion.previous_from_current.between(real).log()[3:]
        assert error @ np.linalg.solve(motion.covariance[3:, 3:], error) < 25.0
    wider, narrower = (np.trace(whole(each[20:60]).covariance[3:, 3:]) for each in (crowd, quiet))
    assert wider > narrower


def test_a_white_wall_says_nothing_and_what_comes_after_it_does():
    images = images_of(walk("sideways", 40))
    noise = 2.0 * np.random.default_rng(0).standard_normal((5, *images[0].shape))
    white = [np.clip(200 + each, 0, 255).astype(np.uint8) for each in noise]
    motions = followed([*images[:20], *white, *images[20:]])
    assert all(each is not None for each in motions[1:20])
    assert all(each is None for each in motions[20:26])
    assert all(each is not None for each in motions[26:])


def test_a_cut_to_another_scene_is_no_motion():
    other = Room(tuple(Board(b.corner, b.depth_m, b.size, b.seed + 20) for b in ROOM.boards))
    images = [*images_of(walk("sideways", 20)), *images_of(walk("sideways", 20), room=other)]
    motions = followed(images)
    assert [i for i, each in enumerate(motions) if each is None] == [0, 21]


def test_an_image_that_comes_twice_is_no_motion_yet_and_for_longer_an_unknown_one():
    images = images_of(walk("sideways", 60))
    twice = [images[i // 2 * 2] for i in range(60)]  # a video of 15 images a second, stated as of 30
    motions = followed(twice)
    assert [i for i, each in enumerate(motions) if each is None] == [0, 1]
    for a in (21, 41):
        held, moved = motions[a], motions[a + 1]
        assert held.previous_from_current.is_identity
        assert np.linalg.norm(held.covariance[:3, :3]) > 0.0
        assert moved.previous_from_current.translation[0] > 0.005
    frozen = followed([*images[:20], *[images[19]] * 40, *images[20:22]])
    assert [i for i, each in enumerate(frozen) if each is None] == [0, *range(50, 60)]


def test_a_longer_pause_is_an_unknown_motion():
    images, visual = images_of(walk("sideways", 4)), VisualOdometry(CAMERA)
    times = [0, STEP_NS, STEP_NS + 1_100_000_000, 2 * STEP_NS + 1_100_000_000]
    motions = [visual.step(image, time) for image, time in zip(images, times, strict=False)]
    assert [each is None for each in motions] == [True, False, True, False]


def test_a_camera_that_zooms_begins_anew():
    images, visual = images_of(walk("sideways", 3)), VisualOdometry(CAMERA)
    half, focused = CAMERA.scaled(160, 120), replace(CAMERA, fx=261.0, fy=261.0)
    assert visual.step(images[0], 0) is None
    assert visual.step(images[1], STEP_NS, focused) is not None
    assert visual.step(np.ascontiguousarray(images[2][::2, ::2]), 2 * STEP_NS, half) is None


def test_large_images_are_scaled_down_and_grey_ones_are_fine():
    images = images_of(walk("sideways", 5))
    visual, grey = VisualOdometry(CAMERA.scaled(1280, 960)), VisualOdometry(CAMERA)
    for i, image in enumerate(images):
        by_large = visual.step(np.repeat(np.repeat(image, 4, axis=0), 4, axis=1), STEP_NS * i)
        by_grey = grey.step(image[:, :, 0].copy(), STEP_NS * i)
    assert by_large is not None
    turned = by_large.previous_from_current.between(by_grey.previous_from_current).log()[3:]
    assert np.degrees(np.linalg.norm(turned)) < 0.3


def test_memory_that_is_used_again_is_another_image():
    images, visual, buffer = images_of(walk("sideways", 5)), VisualOdometry(CAMERA), np.zeros((240, 320), np.uint8)
    motions = []
    for i, image in enumerate(images):
        buffer[:] = image[:, :, 0]
        motions.append(visual.step(buffer, STEP_NS * i))
    assert [each is None for each in motions] == [True] + [False] * 5
    assert all(each.previous_from_current.translation[0] > 0.002 for each in motions[1:])


def test_stamps_that_tremble_do_not_make_wrong_motions_certain():
    true, visual = walk("sideways", 60), VisualOdometry(CAMERA)
    images = images_of(true)
    kept = [i for i in range(61) if i % 8 in (0, 1)]  # 33 and 233 ms apart
    motions = [visual.step(images[i], STEP_NS * i) for i in kept]
    for a, b, motion in zip(kept[5:], kept[6:], motions[6:], strict=False):
        turned = motion.previous_from_current.between(true[a].inverse() @ true[b]).log()[3:]
        assert turned @ np.linalg.solve(motion.covariance[3:, 3:] + 1e-8 * np.eye(3), turned) < 25.0


def test_a_part_of_a_sensor_is_a_camera_of_its_own():
    part = CAMERA.cropped(160, 0, 160, 240)
    images, visual = images_of(walk("sideways", 20)), VisualOdometry(part)
    motions = [visual.step(image[:, 160:].copy(), STEP_NS * i) for i, image in enumerate(images)]
    motion = whole(motions[1:])
    assert np.degrees(np.linalg.norm(motion.previous_from_current.between(walk("sideways", 20)[20]).log()[3:])) < 1.0


@pytest.mark.parametrize("camera", [None, CAMERA])
@pytest.mark.parametrize(
    ("image", "time_ns", "message"),
    [
        (np.zeros((240, 320, 3), np.float32), 1, "image is float32"),
        (np.zeros(5, np.uint8), 1, r"uint8 \(5,\), expected"),
        (np.zeros((240, 320, 4), np.uint8), 1, r"uint8 \(240, 320, 4\), expected"),
        (np.zeros((10, 10, 3), np.uint8), 1, "image is 10 x 10 pixels, its camera 320 x 240"),
        (np.zeros((240, 320, 3), np.uint8), 0, "time_ns is 0 after 0, expected later images"),
    ],
)
def test_bad_input_is_refused_and_changes_nothing(image, time_ns, message, camera):
    images, visual = images_of(walk("sideways", 2)), VisualOdometry(CAMERA)
    visual.step(images[0], 0)
    with pytest.raises(VaporTrackError, match=message):
        visual.step(image, time_ns, camera)
    assert visual.step(images[1], STEP_NS) is not None


@pytest.mark.parametrize("folder", ["tum_fr1/rgbd_dataset_freiburg1_rpy", "7scenes_redkitchen"])
def test_motions_of_real_images_err_as_their_covariances_state(shared_data, folder):
    """Over a third of a second; the unit of each motion is the one that fits it best, within what rooms allow."""
    visual, motions, true = None, [], []
    for frame in islice(posed_frames(shared_data / folder), 101):
        visual = visual or VisualOdometry(frame.camera)
        motions.append(visual.step(frame.image, frame.time_ns, frame.camera))
        true.append(frame.world_from_camera)
    squared = []
    for a in range(15, 90, 5):
        motion, real = whole(motions[a + 1 : a + 11]), true[a].inverse() @ true[a + 10]
        way, length = motion.previous_from_current.translation, real.translation
        unit = float(np.clip((way @ length) / (way @ way), 0.4, 2.5))
        metric = in_metres(motion, unit)
        error = metric.previous_from_current.between(real).log()
        spread = metric.covariance + np.diag([0.005**2] * 3 + [0.005**2] * 3)  # of the true poses
        squared.append(error @ np.linalg.solve(spread, error))
    assert 0.3 < np.mean(squared) < 8.0  # of five degrees of freedom
