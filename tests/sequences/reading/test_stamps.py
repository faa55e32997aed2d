"""Order and time: messages that were logged late, and stamps that cannot be right."""

import re
import struct
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from sequences.errors import SequenceError
from sequences.options import SequenceOptions
from sequences.reader import SequenceReader
from sequences.reading.counts import IN_GAP, OUTSIDE
from tests.helpers.sequence_files import (
    BEGIN_NS,
    IMAGES,
    MS,
    Walk,
    close,
    relogged,
    stamped,
    world_from_camera,
)


def require_same(reader: SequenceReader, reference: Path) -> None:
    """The frames are those of another recording."""
    for frame, expected in zip(reader, SequenceReader(reference), strict=True):
        assert frame.time_ns == expected.time_ns
        np.testing.assert_array_equal(frame.image, expected.image)
        assert close(frame.world_from_camera, world_from_camera(frame.time_ns), 1e-3)
        if expected.odometry is not None:
            assert frame.odometry is not None
            moved = frame.odometry.previous_from_current
            assert close(moved, expected.odometry.previous_from_current, 1e-12)
    assert reader.skipped == {}


@pytest.mark.parametrize("topic", [IMAGES, "/odom", "/ground_truth/pose"])
def test_neighbours_logged_in_swapped_order_are_used_in_the_order_of_their_stamps(topic: str, tmp_path: Path) -> None:
    source = Walk(30).write(tmp_path / "in.mcap")
    step_ns = 20 * MS if topic == "/odom" else 100 * MS

    def late(name: str, time_ns: int) -> int:
        return 3 * step_ns // 2 if name == topic and (time_ns - BEGIN_NS) // step_ns % 2 else 0

    reader = SequenceReader(relogged(source, tmp_path / "out.mcap", late))
    with open(tmp_path / "out.mcap", "rb") as file:
        stamps = [bytes(message.data[4:12]) for _, _, message in make_reader(file).iter_messages([topic])]
    assert sorted(stamps, key=lambda s: struct.unpack("<II", s)) != stamps  # the precondition
    require_same(reader, source)


@pytest.mark.parametrize("topic", ["/odom", "/ground_truth/pose", IMAGES])
@pytest.mark.parametrize("late_s", [2.5, 3600.0, -3600.0])
def test_however_late_a_topic_is_logged_all_images_are_used(topic: str, late_s: float, tmp_path: Path) -> None:
    source = Walk(30).write(tmp_path / "in.mcap")
    path = relogged(source, tmp_path / "out.mcap", lambda name, _: round(late_s * 1e9) if name == topic else 0)
    require_same(SequenceReader(path), source)


def test_odometry_that_is_too_sparse_is_told_from_one_that_ends(tmp_path: Path) -> None:
    walk = Walk(40)
    walk.odometry = walk.odometry[::50]  # one in a second
    reader = SequenceReader(walk.write(tmp_path / "walk.mcap"))
    limit = r"in a gap of odometry over 0\.5 s"
    said = r"odometry of /odom comes every 1 s: no motion is known over gaps of more than 0\.5 s, expected a topic"
    with pytest.raises(SequenceError, match=rf"no image left of 40 .*{limit}.*{said}"):
        list(reader)


@pytest.mark.parametrize("moment", [0, 5 * 10**9])
@pytest.mark.parametrize(
    ("topics", "what"),
    [([IMAGES, "/odom"], "12 images"), ([IMAGES], "12 images"), (["/odom"], r"\d+ messages of odometry")],
)
def test_stamps_that_are_all_equal_are_an_error_that_names_the_log_times(
    topics: list[str], what: str, moment: int, walk_file: Path, tmp_path: Path
) -> None:
    path = stamped(walk_file, tmp_path / "out.mcap", topics, lambda _: moment)
    said = "zero" if moment == 0 else f"{moment} ns"
    with pytest.raises(SequenceError, match=rf"headers of all {what} are {said}, expected increasing.*--stamps log"):
        list(SequenceReader(path))
    require_same(SequenceReader(path, SequenceOptions(stamps="log")), walk_file)


def test_clocks_that_are_apart_are_named(walk_file: Path, tmp_path: Path) -> None:
    path = stamped(walk_file, tmp_path / "out.mcap", ["/odom"], lambda t: t + 3600 * 10**9)
    said = r"images run from \d+\.123 to \d+\.223 s, odometry from \d+\.\d+ to .* s: they begin 3600\.0 s apart"
    with pytest.raises(SequenceError, match=rf"no image has odometry: {said}, expected one clock \(--stamps log"):
        list(SequenceReader(path))
    reader = SequenceReader(path, odometry="optional")
    assert len(list(reader)) == 12
    assert [notice for notice in reader.notices if re.match(said, notice)]
    assert len(list(SequenceReader(path, SequenceOptions(stamps="log")))) == 12


def test_every_image_is_used_or_skipped_for_a_reason(tmp_path: Path) -> None:
    walk = Walk(200)
    walk.images[40] = (walk.images[40][0], b"no image")
    walk.odometry = [(t, pose) for t, pose in walk.odometry if not 5000 < (t - BEGIN_NS) / MS < 6000]
    path = stamped(
        walk.write(tmp_path / "in.mcap"),
        tmp_path / "out.mcap",
        [IMAGES],
        lambda t: t - 100 * MS * (t == BEGIN_NS + 3000 * MS),
    )
    reader = SequenceReader(path, SequenceOptions(start_s=1.0, duration_s=8.0))
    used = len(list(reader))
    lost = {"undecodable image": 1, "time stamp not increasing": 1, IN_GAP: 11}
    assert reader.counts.skipped == {**lost, OUTSIDE: 200 - 81}
    assert reader.counts.read < 200  # reading ended early
    assert (reader.counts.stated, reader.counts.used) == (200, used)
    assert used + reader.counts.skipped.total() == 200
    assert reader.counts.warning is None


def test_where_fewer_than_half_of_the_images_were_used_a_sentence_says_why(tmp_path: Path) -> None:
    walk = Walk(40)
    walk.odometry = [(t, pose) for t, pose in walk.odometry if t < BEGIN_NS + 1000 * MS]
    walk.images[2] = (walk.images[2][0], b"no image")
    path = walk.write(tmp_path / "walk.mcap")
    reader = SequenceReader(path)
    assert len(list(reader)) == 9
    assert reader.counts.warning == "Only 9 of 40 images were used: 30 were skipped: after odometry ends."
    assert not reader.counts.are_very_few
    next(iter(reader))
    assert reader.counts.warning is None  # who takes no more than that knows
    reader = SequenceReader(path, SequenceOptions(start_s=0.9))
    assert len(list(reader)) == 1
    assert reader.counts.are_very_few
    reader = SequenceReader(path, SequenceOptions(duration_s=0.9))
    assert len(list(reader)) == 9
    assert reader.counts.warning is None
