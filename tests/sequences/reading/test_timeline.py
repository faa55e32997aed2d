"""Clocks that are set while a recording is made: of all sensors or of one, ahead and back."""

import struct
from collections.abc import Collection
from pathlib import Path

import pytest

from sequences.options import SequenceOptions
from sequences.reader import SequenceReader
from tests.helpers.sequence_files import BEGIN_NS, IMAGES, MS, ODOMETRY, TRUTH, Walk, close, rewrite, world_from_camera

NUM_IMAGES, SECOND = 40, 10**9
ALL = (IMAGES, ODOMETRY, TRUTH)


def set_clocks(walk: Path, target: Path, steps: Collection[tuple[float, float]], topics: Collection[str]) -> Path:
    """A copy in which clocks were set, by so many seconds from so many seconds on; all of them with that of the log."""

    def told(time_ns: int) -> int:
        return time_ns + sum(round(by_s * 1e9) for at_s, by_s in steps if time_ns - BEGIN_NS >= at_s * 1e9)

    def data(topic: str, time_ns: int, data: bytes) -> bytes:
        return data[:4] + struct.pack("<II", *divmod(told(time_ns), SECOND)) + data[12:] if topic in topics else data

    return rewrite(
        walk,
        target,
        data=data,
        log_time=lambda _, time_ns: told(time_ns) if topics == ALL else time_ns,
        order=lambda _, time_ns: time_ns,
    )


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return Walk(NUM_IMAGES).write(tmp_path_factory.mktemp("walk") / "walk.mcap")


def require_whole(path: Path, *, pause_m: float = 0.0) -> SequenceReader:
    """All images are there, with the odometry and the true poses of when they were taken."""
    reader = SequenceReader(path)
    frames = list(reader)
    assert reader.skipped == {}
    assert len(frames) == NUM_IMAGES
    was = [world_from_camera(BEGIN_NS + 100 * MS * index) for index in range(NUM_IMAGES)]
    for index, frame in enumerate(frames):
        assert close(frame.world_from_camera, was[index], 1e-2 + pause_m)
        if index:
            assert 70 * MS < frame.time_ns - frames[index - 1].time_ns < 130 * MS
            assert frame.odometry is not None
            moved = was[index - 1].inverse() @ was[index]
            assert close(frame.odometry.previous_from_current, moved, 1e-2 + pause_m)
    return reader


@pytest.mark.parametrize("by_s", [-1.7e9 + 10, -5.0, 37.0, 3 * 86_400.0])
@pytest.mark.parametrize("topics", [ALL, (IMAGES,), (ODOMETRY,), (TRUTH,)], ids=" ".join)
def test_where_a_clock_is_set_all_images_are_used(
    by_s: float, topics: tuple[str, ...], walk: Path, tmp_path: Path
) -> None:
    if topics == ALL and 0 < by_s <= 86_400:
        by_s *= 1e4  # all clocks that go on less than a day later are those of a recording that was paused
    reader = require_whole(set_clocks(walk, tmp_path / "set.mcap", [(2.05, by_s)], topics), pause_m=0.03)
    (said,) = [notice for notice in reader.notices if "the clock of " in notice]
    named, _, others = said.removeprefix("the clock of ").partition(" was set by ")[0].partition(" and ")
    assert f" was set by {by_s:+.3f}"[:-3] in said
    assert named in topics
    assert others == (f"{len(topics) - 1} more" if len(topics) > 1 else "")


def test_clocks_that_are_set_twice_are_followed(walk: Path, tmp_path: Path) -> None:
    steps = [(1.05, 20.0), (2.55, -20.0)]
    for topics in ((IMAGES,), (ODOMETRY,)):
        reader = require_whole(set_clocks(walk, tmp_path / "set.mcap", steps, topics))
        assert [frame.time_ns for frame in reader] == [BEGIN_NS + 100 * MS * index for index in range(NUM_IMAGES)]
        assert sum("the clock of " in notice for notice in reader.notices) == 2


def test_the_clock_of_each_sensor_may_be_set_at_another_time(walk: Path, tmp_path: Path) -> None:
    path = set_clocks(walk, tmp_path / "a.mcap", [(1.05, 20.0)], (IMAGES,))

    def data(topic: str, time_ns: int, data: bytes) -> bytes:
        if topic != ODOMETRY or time_ns - BEGIN_NS < 2.5e9:
            return data
        return data[:4] + struct.pack("<II", *divmod(time_ns - 50 * SECOND, SECOND)) + data[12:]

    reader = require_whole(rewrite(path, tmp_path / "b.mcap", data=data))
    assert len([notice for notice in reader.notices if "the clock of " in notice]) == 2


def test_a_segment_is_counted_by_the_steady_clock(walk: Path, tmp_path: Path) -> None:
    path = set_clocks(walk, tmp_path / "set.mcap", [(1.05, -1e9)], ALL)
    reader = SequenceReader(path, SequenceOptions(start_s=0.5, duration_s=2.0))
    whole = [frame.time_ns for frame in SequenceReader(path)]
    assert [frame.time_ns for frame in reader] == whole[5:26]
    assert reader.counts.are_complete


def test_messages_that_are_held_up_and_catch_up_are_of_one_clock(walk: Path, tmp_path: Path) -> None:
    def held_up(topic: str, time_ns: int) -> int:
        return max(time_ns, BEGIN_NS + 3 * SECOND) if topic == ODOMETRY and time_ns > BEGIN_NS else time_ns

    reader = require_whole(rewrite(walk, tmp_path / "late.mcap", log_time=held_up))
    assert not reader.notices
