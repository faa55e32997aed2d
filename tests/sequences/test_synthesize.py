from itertools import islice
from typing import Literal

import numpy as np
import pytest

from sequences import synthesize as synthesize_module
from sequences.errors import SequenceError
from sequences.paths import Stand
from sequences.rendering.render import render, sees_cue
from sequences.scenes import SCENES, find_scene
from sequences.synthesize import SyntheticSequence, synthesize
from tests.helpers.views import depth_and_quads

pytestmark = pytest.mark.usefixtures("unchecked", "rough_light")


@pytest.fixture(scope="module", params=SCENES)
def name(request) -> str:
    return request.param


@pytest.fixture(scope="module", params=[name for name in SCENES if find_scene(name).has_cues])
def name_with_cues(request) -> str:
    """Of a scene that has something unique."""
    return request.param


def test_the_same_seed_gives_the_same_bytes_and_another_seed_or_split_does_not(name):
    def first_images(seed: int, split: Literal["train", "test"]) -> np.ndarray:
        return np.stack(
            list(islice(synthesize(name, seed=seed, num_frames=30, split=split, width=64, height=48).images(), 3))
        )

    original = first_images(5, "test")
    assert original.dtype == np.uint8
    assert original.shape == (3, 48, 64, 3)
    np.testing.assert_array_equal(original, first_images(5, "test"))
    assert (original != first_images(6, "test")).mean() > 0.3
    assert (original != first_images(5, "train")).mean() > 0.3


def test_odometry_at_50_hz_covers_images_at_10_hz_with_a_margin(name):
    sequence = synthesize(name, seed=0, num_frames=25)
    assert set(np.diff(sequence.image_times_ns)) == {100_000_000}
    assert set(np.diff(sequence.odometry_times_ns)) == {20_000_000}
    assert sequence.odometry_times_ns[0] < sequence.image_times_ns[0] - 200_000_000
    assert sequence.odometry_times_ns[-1] > sequence.image_times_ns[-1] + 200_000_000
    np.testing.assert_array_equal(sequence.odom_from_base.as_matrix()[0], np.eye(4))
    assert len(sequence.odom_from_base) == len(sequence.twist_covariances) == len(sequence.odometry_times_ns)


def test_test_paths_pass_something_unique_in_their_first_half_but_seldom(name_with_cues):
    for seed in range(4):
        sequence = synthesize(name_with_cues, seed=seed, num_frames=300, width=64, height=48)
        seen = sees_cue(sequence.scene, sequence.camera, sequence.world_from_camera)
        assert seen[:150].sum() >= 5
        assert seen.mean() < 0.25


def test_paths_without_anything_unique_show_none_of_it_even_at_full_resolution(name_with_cues):
    for seed in range(3):
        sequence = synthesize(name_with_cues, seed=seed, num_frames=120, cues="none", width=160, height=120)
        assert len(sequence.world_from_camera) == 120
        assert sequence.odometry_times_ns[-1] > sequence.image_times_ns[-1] + 200_000_000
        scene = sequence.scene
        quads = [depth_and_quads(scene, sequence.camera, pose)[1] for pose in sequence.world_from_camera[::6]]
        assert max((scene.geometry.cue[seen] & (seen >= 0)).mean() for seen in quads) < 0.002


def test_cues_follow_from_the_split_where_they_are_not_asked_for(name_with_cues):
    def path(**options) -> np.ndarray:
        found = synthesize(name_with_cues, seed=5, num_frames=150, width=64, height=48, **options)
        return found.world_from_camera.as_matrix()

    np.testing.assert_array_equal(path(), path(cues="early"))
    np.testing.assert_array_equal(path(split="train"), path(split="train", cues="any"))


def test_where_something_unique_always_shows_no_path_is_without(name_with_cues, monkeypatch):
    monkeypatch.setattr(synthesize_module, "sees_cue", lambda scene, camera, poses, **_: np.ones(len(poses), bool))
    with pytest.raises(
        SequenceError, match=f"{name_with_cues}, seed 3: no random path has 10 images in a row .* another seed"
    ):
        synthesize(name_with_cues, seed=3, num_frames=10, cues="none")


def test_images_are_exposed_neither_black_nor_white(name):
    sequence = synthesize(name, seed=3, num_frames=40, width=64, height=48)
    levels = np.array([np.median(image) for image in islice(sequence.images(), 0, None, 5)])
    assert (levels > 50).all()
    assert (levels < 210).all()


# --- other rates, and standing ---------------------------------------------------------------------


def small(name: str = "corridor", num_frames: int = 40, **options) -> SyntheticSequence:
    return synthesize(name, seed=3, num_frames=num_frames, width=32, height=24, **options)


@pytest.mark.parametrize(("rate_hz", "times"), [(30.0, 3), (50.0, 5)])
def test_a_faster_camera_on_the_same_walk_takes_the_same_images_and_others_between(rate_hz, times):
    slow, fast = small(), small(num_frames=40 * times, rate_hz=rate_hz)
    np.testing.assert_array_equal(fast.image_times_ns[::times], slow.image_times_ns)
    np.testing.assert_array_equal(fast.world_from_camera.as_matrix()[::times], slow.world_from_camera.as_matrix())
    np.testing.assert_array_equal(fast.odom_from_base.as_matrix(), slow.odom_from_base.as_matrix())
    assert fast.odometry_times_ns[-1] > fast.image_times_ns[-1] + 200_000_000
    assert len(fast.image_times_ns) == len(fast.world_from_camera) == 40 * times
    steps = np.diff(fast.image_times_ns)
    assert steps.max() - steps.min() <= 1  # ns


def test_a_slower_camera_on_the_same_walk_takes_some_of_the_same_images():
    fast, slow = small(num_frames=42), small(num_frames=14, rate_hz=10 / 3)
    np.testing.assert_array_equal(slow.image_times_ns, fast.image_times_ns[::3])
    np.testing.assert_array_equal(slow.odom_from_base.as_matrix(), fast.odom_from_base.as_matrix())


def test_exposure_follows_the_light_in_the_same_time_at_every_rate(monkeypatch):
    def exposures(sequence: SyntheticSequence) -> np.ndarray:
        taken = []
        monkeypatch.setattr(synthesize_module, "develop", lambda light, camera, exposure, **_: taken.append(exposure))
        light = iter([-3.0] + [1.0] * 1000)  # what the metering asks for: one dark image, then bright ones
        monkeypatch.setattr(synthesize_module, "metered_exposure", lambda radiance: next(light))
        list(sequence.images())
        return np.array(taken)

    slow, fast = exposures(small()), exposures(small(num_frames=120, rate_hz=30.0))
    assert abs(slow[5] - fast[15]) < 0.5
    assert slow[5] < 0.6
    assert abs(slow[20:].mean() - 1) < 0.3
    assert abs(fast[60:].mean() - 1) < 0.3


@pytest.mark.parametrize("rate_hz", [10.0, 30.0])
def test_a_camera_that_stands_keeps_its_pose_from_the_image_on_for_as_long_as_asked(rate_hz):
    walk, sequence = small(rate_hz=rate_hz), small(rate_hz=rate_hz, stand=Stand(20, 8.0))
    assert len(sequence.image_times_ns) == 20 + round(8 * rate_hz)
    poses = sequence.world_from_camera
    distance_m, angle_rad = poses[20].distance(poses[20:])
    assert max(distance_m.max(), angle_rad.max()) < 1e-9
    moved_m, _ = poses[18].distance(poses[20])
    assert moved_m > 1e-4  # and not before
    walked = 20 - int(0.5 * rate_hz)
    np.testing.assert_array_equal(poses.as_matrix()[:walked], walk.world_from_camera.as_matrix()[:walked])
    late_m, _ = poses[20].distance(walk.world_from_camera[20])
    assert late_m < 0.5  # where the walk was at that time, but for stopping
    speed = np.linalg.norm(np.diff(sequence.world_from_base.translation, axis=0), axis=1)
    assert speed.max() <= np.linalg.norm(np.diff(walk.world_from_base.translation, axis=0), axis=1).max() + 1e-9


def test_odometry_of_a_camera_that_stands_goes_on_with_noise_and_bias():
    sequence = small(stand=Stand(20, 60.0))
    still = sequence.odometry_times_ns > sequence.image_times_ns[20]
    moved = sequence.odom_from_base.translation[still]
    step = np.diff(moved, axis=0)
    assert step.std() == pytest.approx(0.008 * np.sqrt(0.02), rel=0.1)
    assert 0.02 < np.linalg.norm(moved[-1] - moved[0]) < 3
    assert sequence.odometry_times_ns[-1] > sequence.image_times_ns[-1] + 200_000_000
    assert (np.linalg.eigvalsh(sequence.twist_covariances) > 0).all()


def test_a_camera_that_stands_sees_the_same_under_noise_of_its_own_and_light_is_traced_once(monkeypatch):
    traced = []

    def counted(*arguments, **options):
        traced.append(1)
        return render(*arguments, **options)

    monkeypatch.setattr(synthesize_module, "render", counted)
    images = np.stack(list(small(stand=Stand(5, 30.0)).images())).astype(float)
    assert len(images) == 305
    assert len(traced) <= 7
    standing = images[100:]  # exposure has settled
    change = np.abs(np.diff(standing, axis=0))
    assert change.mean(axis=(1, 2, 3)).min() > 0.5  # of 255
    assert change.mean() < 8
    brightness = standing.mean(axis=(1, 2, 3))
    assert brightness.std() > 0.5  # auto exposure goes on
    early, late = standing[:100].mean(axis=0), standing[100:].mean(axis=0)
    assert np.corrcoef(early.ravel(), late.ravel())[0, 1] > 0.99


def test_a_camera_that_stood_walks_on_along_the_rest_of_its_path():
    walk, sequence = small(num_frames=60), small(num_frames=60, stand=Stand(20, 3.0, walks_on=True))
    assert len(sequence.image_times_ns) == 60 + 30
    distance_m, _ = sequence.world_from_camera[20].distance(sequence.world_from_camera[20:50])
    assert distance_m.max() < 1e-9
    path = walk.world_from_base.translation
    end = (sequence.world_from_camera[-1] @ sequence.base_from_camera.inverse()).translation
    distance_m = np.linalg.norm(path - end, axis=1)
    assert distance_m.min() < 0.02
    last = (walk.image_times_ns[-1] - walk.odometry_times_ns[0]) // 20_000_000
    assert abs(distance_m.argmin() - (last - 20)) <= 2  # stopping and starting lose 0.2 s of walking each
    assert sequence.odometry_times_ns[-1] > sequence.image_times_ns[-1] + 200_000_000


@pytest.mark.parametrize("walks_on", [False, True])
def test_a_short_stand_before_a_slow_camera_is_one_image_and_odometry_covers_all(walks_on):
    sequence = small(num_frames=4, rate_hz=0.5, stand=Stand(0, 0.1, walks_on=walks_on))
    assert len(sequence.image_times_ns) == (5 if walks_on else 1)
    assert sequence.odometry_times_ns[-1] > sequence.image_times_ns[-1] + 200_000_000


@pytest.mark.parametrize(
    ("options", "said"),
    [
        *(({"rate_hz": rate}, r"images a second, expected 0\.1 to 200") for rate in (0.0, -10.0, 1e4, float("nan"))),
        *(
            ({"stand": stand}, "expected an image below 40")
            for stand in (Stand(40, 1.0), Stand(-1, 1.0), Stand(3, 0.0), Stand(3, float("nan")))
        ),
        ({"name": "cellar"}, "unknown scene 'cellar', expected one of staircase, ceiling, round-table, dinner-table"),
        ({"num_frames": 0}, "0 frames of 32 × 24 pixels"),
    ],
)
def test_a_sequence_that_cannot_be_is_refused(options, said):
    with pytest.raises(SequenceError, match=said):
        small(**options)
