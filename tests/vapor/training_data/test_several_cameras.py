"""Training images of recordings by several cameras."""

from pathlib import Path

import numpy as np
import pytest

from tests.helpers.rigs import CAMERA_FROM_LEFT, FRONT, LEFT, RIGHT, Rig
from tests.helpers.sequence_files import Walk, close, world_from_camera
from vapor.inspection.reading import read_walks
from vapor.training.holding_out import hold_out, way_of
from vapor.training_data.entries import open_sequences
from vapor.training_data.ground import odometry_segments
from vapor.training_data.load import load_training_set
from vapor.training_data.training_set import TrainingSet


@pytest.fixture(scope="module")
def loaded(tmp_path_factory: pytest.TempPathFactory) -> TrainingSet:
    folder, rig = tmp_path_factory.mktemp("rigs"), Rig({"left": 0, "right": 0}, {"right": 2})
    paths = [rig.write(folder / f"walk{i}.mcap", Walk(60)) for i in range(4)]
    return load_training_set(open_sequences(paths), (24, 16))


def test_the_images_of_each_camera_are_a_sequence_of_their_walk(loaded: TrainingSet) -> None:
    assert loaded.cameras == (FRONT, LEFT, RIGHT)
    assert loaded.names[:4] == ("walk0.mcap, " + FRONT, "walk0.mcap, " + LEFT, "walk0.mcap, " + RIGHT, loaded.names[3])
    assert loaded.walks == (0, 0, 0, 1, 1, 1, 2, 2, 2, 3, 3, 3)
    np.testing.assert_array_equal(np.unique(loaded.walk, return_counts=True)[1], [150] * 4)
    left = np.flatnonzero(loaded.sequence == 1)
    for i in left[::20].tolist():
        truth = world_from_camera(int(loaded.times_ns[i]) // 1000 * 1000 + 789) @ CAMERA_FROM_LEFT
        assert close(loaded.poses[i], truth, 2e-3)


def test_the_odometry_of_each_camera_is_its_own_and_counts_once_a_walk(loaded: TrainingSet) -> None:
    left = np.flatnonzero(loaded.sequence == 1)
    for i in left[1:40].tolist():
        step = loaded.odometry[i]
        assert step is not None
        assert close(step.previous_from_current, loaded.poses[i - 1].inverse() @ loaded.poses[i], 5e-3)
    assert [segment.recording for segment in odometry_segments(loaded)] == [0, 3, 6, 9]


def test_a_pass_is_held_out_with_all_of_its_cameras(loaded: TrainingSet) -> None:
    split = hold_out(loaded, 0.25)
    held_out = np.unique(loaded.walk[split.held_out_mask])
    assert len(held_out) == 1
    training = np.unique(loaded.walk[np.isin(loaded.rows, split.training.rows)])
    assert held_out[0] not in training
    assert len(np.unique(loaded.sequence[split.held_out_mask])) == 3


def test_all_cameras_of_a_walk_have_come_as_far_at_the_same_time(loaded: TrainingSet) -> None:
    way = way_of(loaded)
    for walk in range(4):
        front, right = (np.flatnonzero(loaded.sequence == 3 * walk + camera) for camera in (0, 2))
        np.testing.assert_allclose(way[right], way[front][::2], atol=1e-5)


def test_a_camera_without_any_usable_image_is_left_out_of_training_and_told(tmp_path: Path) -> None:
    path = Rig({"left": 0, "right": 0}, {}).write(tmp_path / "walk.mcap", spoilt="left")
    loaded = load_training_set(open_sequences([path]), (24, 16))
    assert loaded.names == ("walk.mcap, " + FRONT, "walk.mcap, " + RIGHT)
    assert any(notice.startswith(f"{LEFT} is left out: ") for notice in loaded.notices)
    (walk, *_) = read_walks([path])
    assert [each.name for each in read_walks([path])] == [*loaded.names]
    assert any(notice.startswith(f"{LEFT} is left out: ") for notice in walk.source.notices)


def test_the_way_of_a_camera_goes_on_after_the_first_one_has_ended(tmp_path: Path) -> None:
    walk = Walk(60)
    walk.images = walk.images[10:30]  # of the first camera
    path = Rig({"left": 0}, {}).write(tmp_path / "walk.mcap", walk, beside=Walk(60))
    loaded = load_training_set(open_sequences([path]), (24, 16))
    way, left = way_of(loaded), np.flatnonzero(loaded.sequence == 1)
    steps = np.diff(way[left])
    assert len(left) == 60
    assert (steps > 0.0).all()
    alone = way_of(loaded.select(left))
    np.testing.assert_allclose(steps, np.diff(alone), rtol=0.35)
