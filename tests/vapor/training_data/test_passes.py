from dataclasses import replace

import numpy as np

from tests.helpers.simulation import frames_of
from vapor.training_data.load import load_training_set
from vapor.training_data.passes import odometry_segments, pass_numbers, some_runs


def spans(numbers: np.ndarray) -> list[tuple[int, int]]:
    begins = np.flatnonzero(np.diff(numbers, prepend=-1))
    return list(zip(begins.tolist(), [*begins[1:].tolist(), len(numbers)], strict=True))


def test_passes_break_where_sequences_and_time_do():
    late = [replace(f, time_ns=f.time_ns + (2 * 10**9 if i >= 90 else 0)) for i, f in enumerate(frames_of(150))]
    slow = frames_of(20, step_ns=2 * 10**9)  # one image in two seconds is usual there
    images = load_training_set({"a": frames_of(60), "b": late, "slow": slow}, (36, 36))
    assert spans(pass_numbers(images)) == [(0, 60), (60, 150), (150, 210), (210, 230)]


def test_of_many_images_runs_of_ten_are_taken_all_over():
    np.testing.assert_array_equal(some_runs(70, 70), np.arange(70))
    chosen = some_runs(1000, 100)
    assert len(chosen) == 100
    assert (chosen[0], chosen[-1]) == (0, 999)
    assert sorted(set(np.diff(chosen).tolist())) == [1, 101]
    assert len(some_runs(60, 55)) <= 55
    np.testing.assert_array_equal(some_runs(9, 4), [0, 1, 2, 3])


def test_segments_of_odometry_have_one_true_pose_more_than_increments():
    frames = frames_of(150)
    frames[60] = replace(frames[60], odometry=None)
    images = load_training_set({"a": frames, "b": frames_of(30, odometry=False), "c": frames_of(30)}, (36, 36))
    segments = odometry_segments(images)
    assert [(len(s.odometry), len(s.truth), s.recording) for s in segments] == [(59, 60, 0), (89, 90, 0), (29, 30, 2)]
    np.testing.assert_array_equal(segments[1].truth[0].translation, frames[60].world_from_camera.translation)
    assert images.select(np.arange(5, 9)).odometry == (None, *images.odometry[6:9])
    assert odometry_segments(images.select(np.arange(0, 150, 2))) == []
    assert odometry_segments(images.select(np.arange(0))) == []
