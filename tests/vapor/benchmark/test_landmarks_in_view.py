"""Which trials a benchmark consists of: decided by where a landmark is in view, and by nothing else."""

import numpy as np
import pytest

from filtering.errors import VaporTrackError
from filtering.se3 import Poses
from vapor.benchmark.recordings.storage import CameraPath
from vapor.benchmark.trials.choose import (
    KINDS,
    Excerpt,
    Trial,
    choose_trials,
    cue_starts,
    recorded_images,
    spread_starts,
    walk_frames,
)

FRAMES = 60


def path_seeing(images, *, count: int = 2 * FRAMES, away_m: float = 0.0) -> CameraPath:
    """Along x at 0.1 m per image, with something unique at the given images."""
    seen = np.zeros(count, bool)
    seen[list(images)] = True
    x = away_m + 0.1 * np.arange(count)
    return CameraPath(Poses(np.tile(np.eye(3), (count, 1, 1)), np.column_stack([x, 0 * x, 0 * x])), seen)


def wide_apart(seed: int) -> CameraPath:
    return path_seeing(range(10, 100), away_m=100.0 * seed)


def chosen(kind, *, runs: int, path=wide_apart, first_seed: int = 7) -> list[Trial]:
    return choose_trials("ceiling", kind, runs=runs, first_seed=first_seed, frames=FRAMES, path=path)


def test_a_segment_counts_from_five_images_with_something_unique_on():
    seen = np.zeros(40, bool)
    seen[20:25] = True
    assert cue_starts(seen, length=20, within=10).tolist() == [15, 16, 17, 18, 19, 20]
    seen[22] = False
    assert len(cue_starts(seen, length=20, within=10)) == 0
    assert len(cue_starts(seen, length=41, within=10)) == 0  # longer than all there is


def test_windows_of_a_recording_begin_by_chance_but_apart():
    starts = np.arange(300)
    several = [spread_starts(starts, rng=np.random.default_rng(seed)) for seed in range(30)]
    for chosen_starts in several:
        assert 1 < len(chosen_starts) <= 4
        assert np.diff(chosen_starts).min() >= 60
        assert set(chosen_starts) <= set(starts.tolist())
    assert len({first for first, *_ in several}) > 15
    assert spread_starts(starts[:0], rng=np.random.default_rng(0)) == []


def test_every_cue_run_sees_something_unique_in_its_first_half():
    trials = chosen("cue", runs=5)
    for trial in trials:
        (segment,) = trial.segments
        assert segment.length == FRAMES
        assert wide_apart(segment.seed).sees_cue[segment.start : segment.start + FRAMES // 2].sum() >= 5
        assert segment.start + FRAMES <= walk_frames("cue", FRAMES)
    assert len({trial.name for trial in trials}) == 5
    assert trials[0].name == f"ceiling-cue-7-{trials[0].segments[0].start}"


@pytest.mark.parametrize("kind", KINDS)
def test_fewer_runs_are_the_first_of_more_and_the_same_every_time(kind):
    assert chosen(kind, runs=3) == chosen(kind, runs=9)[:3]
    assert chosen(kind, runs=3, first_seed=8) != chosen(kind, runs=3)


def test_seeds_without_anything_unique_are_passed_over():
    trials = chosen("cue", runs=2, path=lambda seed: wide_apart(seed) if seed > 20 else path_seeing([]))
    assert min(trial.segments[0].seed for trial in trials) == 21


def standing_still(seed: int) -> CameraPath:
    return CameraPath(Poses.identity(2 * FRAMES), np.ones(2 * FRAMES, bool))


@pytest.mark.parametrize(
    ("kind", "path"),
    [("cue", lambda seed: path_seeing([])), ("standing-cue", lambda seed: path_seeing([])), ("kidnap", standing_still)],
)
def test_where_nothing_unique_is_seen_or_all_places_are_near_the_search_ends(kind, path):
    expected = f"ceiling: 0 {kind} trials of 60 images in seeds 7 to 57, expected 2"
    with pytest.raises(VaporTrackError, match=expected):
        chosen(kind, runs=2, path=path)


@pytest.mark.parametrize(
    ("kind", "cues", "rate", "stride"),
    [
        ("no-cue", "none", 1, 1),
        ("walk", "early", 1, 1),
        ("rate-3", "early", 3, 10),
        ("rate-10", "early", 3, 3),
        ("rate-30", "early", 3, 1),
    ],
)
def test_some_kinds_take_whole_recordings_of_which_some_images_are_seen(kind, cues, rate, stride):
    assert chosen(kind, runs=2) == [Trial("ceiling", kind, (Excerpt(s, 0, rate * FRAMES),), stride) for s in (7, 8)]
    assert recorded_images(kind, walk_frames(kind, FRAMES)) == rate * FRAMES
    assert KINDS[kind].cues == cues


@pytest.mark.parametrize(("kind", "rate"), [("standing", 1), ("standing-30", 3)])
def test_a_standing_camera_walks_for_five_seconds_and_stands_for_five_minutes(kind, rate):
    assert chosen(kind, runs=1) == [Trial("ceiling", kind, (Excerpt(7, 0, rate * 3050, rate * 50),))]
    assert walk_frames(kind, FRAMES) == 51  # while it stands, the path does not go on


def test_a_camera_stops_before_something_unique_where_there_is_any_after_five_seconds():
    seen = [*range(20, 30), *range(60, 64), *range(70, 90)]  # too early, and too short
    (trial,) = chosen("standing-cue", runs=1, path=lambda seed: path_seeing(seen if seed > 8 else range(50)))
    assert trial.segments == (Excerpt(9, 0, 3074, 74),)


def test_a_kidnap_goes_far_and_lands_where_something_unique_is_soon_seen():
    # Each path begins 3 m after its forerunner's beginning: only some landings are more than 2 m away.
    def near(seed: int) -> CameraPath:
        return path_seeing(range(2 * FRAMES), away_m=3.0 * seed)

    trials = chosen("kidnap", runs=20, path=near)
    jumps = []
    for trial in trials:
        before, after = trial.segments
        assert (before.length, after.length, trial.kidnap_index) == (40, 20, 40)
        assert after.seed == before.seed + 1
        assert before.start + before.length < 2 * FRAMES  # one more image, for the odometry at the kidnap
        assert near(before.seed).sees_cue[before.start : before.start + 20].sum() >= 5
        assert near(after.seed).sees_cue[after.start : after.start + FRAMES // 10].sum() >= 5
        left = near(before.seed).world_from_camera.translation[before.start + before.length - 1, 0]
        jumps.append(near(after.seed).world_from_camera.translation[after.start, 0] - left)
    assert min(np.abs(jumps)) > 2.0
    assert max(jumps) - min(jumps) > 4.0  # by chance among those
