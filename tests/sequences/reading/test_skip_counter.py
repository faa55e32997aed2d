"""Images and messages that cannot be used: they are counted, or end the reading."""

import re
from collections.abc import Callable, Collection
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from filtering.se3 import Poses
from sequences.errors import SequenceError
from sequences.options import OdometryUse
from sequences.reader import SequenceReader
from sequences.reading.counts import AFTER, BEFORE, IN_GAP, ODD
from tests.helpers.sequence_files import BEGIN_NS, IMAGES, Walk, close, rewrite, world_from_camera


def test_an_undecodable_image_is_skipped_and_the_next_increment_spans_it(tmp_path: Path) -> None:
    walk = Walk()
    walk.images[5] = (walk.images[5][0], b"no image")
    reader = SequenceReader(walk.write(tmp_path / "walk.mcap"))
    frames = list(reader)
    assert reader.skipped == {"undecodable image": 1}
    assert len(frames) == 11
    truth = world_from_camera(frames[4].time_ns).inverse() @ world_from_camera(frames[5].time_ns)
    assert frames[5].time_ns - frames[4].time_ns == 200_000_000
    assert frames[5].odometry is not None
    assert close(frames[5].odometry.previous_from_current, truth, 1e-4)


def test_bytes_that_are_no_image_message_are_skipped(walk_file: Path, tmp_path: Path) -> None:
    def cut(topic: str, time_ns: int, data: bytes) -> bytes:
        return data[:7] if topic == IMAGES and time_ns == BEGIN_NS + 300_000_000 else data

    reader = SequenceReader(rewrite(walk_file, tmp_path / "out.mcap", data=cut))
    assert len(list(reader)) == 11
    assert reader.skipped == {"undecodable image": 1}


@pytest.mark.parametrize("back_ns", [0, 300_000_000])
def test_image_stamps_that_were_there_before_are_skipped(back_ns: int, tmp_path: Path) -> None:
    walk = Walk()
    path = walk.write(tmp_path / "in.mcap")
    before_ns = BEGIN_NS + 400_000_000 - back_ns
    header = before_ns // 1_000_000_000, before_ns % 1_000_000_000

    def stamped(topic: str, time_ns: int, data: bytes) -> bytes:
        if topic != IMAGES or time_ns != BEGIN_NS + 500_000_000:
            return data
        # The stamp is the first thing after the four bytes that begin every message.
        return data[:4] + np.array(header, "<u4").tobytes() + data[12:]

    reader = SequenceReader(rewrite(path, tmp_path / "out.mcap", data=stamped))
    times = [frame.time_ns for frame in reader]
    assert len(times) == 11
    assert times == sorted(set(times))
    assert reader.skipped == {"time stamp not increasing": 1}


def test_images_that_odometry_does_not_cover_are_skipped(tmp_path: Path) -> None:
    walk = Walk()
    # Starts after the first two images, ends before the last one, and is silent from 0.45 to 1.01 s.
    ms = 1_000_000
    walk.odometry = [
        (t, pose)
        for t, pose in walk.odometry
        if 150 * ms <= t - BEGIN_NS <= 1090 * ms and not 450 * ms < t - BEGIN_NS < 1000 * ms
    ]
    reader = SequenceReader(walk.write(tmp_path / "walk.mcap"))
    indices = [(frame.time_ns - BEGIN_NS) // (100 * ms) for frame in reader]
    assert indices == [2, 3, 4]
    assert reader.skipped == {BEFORE: 2, IN_GAP: 6, AFTER: 1}


def flattened(times_ns: Collection[int]) -> Callable[[str, int, bytes], bytes]:
    """Odometry of some times gets a quaternion of zeros."""

    def rewritten(topic: str, time_ns: int, data: bytes) -> bytes:
        if topic != "/odom" or time_ns not in times_ns:
            return data
        # header (8 + 4 + "odom\0"), child frame (4 + "base_link\0"), then aligned to 8 from byte 4 on: the pose.
        start = data.index(b"base_link\0") + len(b"base_link\0")
        start += -(start - 4) % 8 + 24
        return data[:start] + bytes(32) + data[start + 32 :]

    return rewritten


NOWHERE = Poses(np.eye(3), np.array([np.nan, 0.0, 0.0]))


@pytest.mark.parametrize("kind", ["not finite", "quaternion of length 0"])
def test_odometry_that_is_no_pose_is_left_out_and_the_rest_used(kind: str, tmp_path: Path) -> None:
    walk, bad = Walk(), (12, 30)
    if kind == "not finite":
        for index in bad:
            walk.odometry[index] = (walk.odometry[index][0], NOWHERE)
    path = walk.write(tmp_path / "in.mcap")
    if kind != "not finite":
        path = rewrite(path, tmp_path / "out.mcap", data=flattened([walk.odometry[index][0] for index in bad]))
    reader = SequenceReader(path)
    frames = list(reader)
    assert len(frames) == 12
    for before, frame in pairwise(frames):
        assert frame.odometry is not None
        truth = world_from_camera(before.time_ns).inverse() @ world_from_camera(frame.time_ns)
        assert close(frame.odometry.previous_from_current, truth, 1e-2)
    assert reader.skipped == {"unusable poses of odometry": 2}
    (said,) = [notice for notice in reader.notices if "left out" in notice]
    assert re.match(
        rf"2 of \d+ poses of odometry left out, the first: .*: /odom at {walk.odometry[12][0]} ns: .*{kind}", said
    )


@pytest.mark.parametrize("what", ["odometry", "truth"])
def test_where_more_poses_than_not_are_none_the_recording_is_refused(what: str, tmp_path: Path) -> None:
    walk = Walk()
    poses = getattr(walk, what)
    setattr(walk, what, [(t, pose if n % 3 == 0 else NOWHERE) for n, (t, pose) in enumerate(poses)])
    topic = {"odometry": "/odom", "truth": "/ground_truth/pose"}[what]
    reader = SequenceReader(walk.write(tmp_path / "in.mcap"), true_poses="required")
    said = rf"in\.mcap: {topic} at \d+ ns: .*not finite.*; \d+ of \d+ .*, expected at most one in two"
    with pytest.raises(SequenceError, match=said):
        list(reader)


def test_odometry_stamps_that_stand_or_run_backwards_are_skipped(tmp_path: Path) -> None:
    def stalled(topic: str, time_ns: int, data: bytes) -> bytes:
        if topic != "/odom" or (time_ns // 20_000_000) % 10:
            return data
        return data[:4] + np.array([1, 1], "<u4").tobytes() + data[12:]

    reader = SequenceReader(rewrite(Walk().write(tmp_path / "in.mcap"), tmp_path / "out.mcap", data=stalled))
    assert len(list(reader)) == 12
    assert reader.skipped.keys() == {f"{ODD} on /odom"}


def far_ahead(of_topic: str, walk: Path, target: Path) -> Path:
    """A copy in which one message of a topic, about half a second after the first image, is stamped years later."""
    at_ns = BEGIN_NS + {IMAGES: 500_000_000, "/odom": 507_000_000, "/ground_truth/pose": 500_000_000}[of_topic]

    def stamped(topic: str, time_ns: int, data: bytes) -> bytes:
        if topic != of_topic or time_ns != at_ns:
            return data
        return data[:4] + np.array([2_000_000_000, 0], "<u4").tobytes() + data[12:]

    return rewrite(walk, target, data=stamped)


@pytest.mark.parametrize("odometry", ["required", "optional", "unread"])
def test_a_stamp_far_in_the_future_costs_one_image_only(odometry: OdometryUse, tmp_path: Path) -> None:
    path = far_ahead(IMAGES, Walk().write(tmp_path / "in.mcap"), tmp_path / "out.mcap")
    reader = SequenceReader(path, odometry=odometry)
    assert [f.time_ns for f in reader] == [BEGIN_NS + 100_000_000 * i for i in range(12) if i != 5]
    assert reader.skipped == {ODD: 1}


@pytest.mark.parametrize(("topic", "num_true_poses"), [("/odom", 12), ("/ground_truth/pose", 11)])
def test_a_stamp_far_in_the_future_costs_one_pose_only(topic: str, num_true_poses: int, tmp_path: Path) -> None:
    path = far_ahead(topic, Walk().write(tmp_path / "in.mcap"), tmp_path / "out.mcap")
    reader = SequenceReader(path)
    frames = list(reader)
    assert len(frames) == 12
    assert all(frame.odometry is not None for frame in frames[1:])
    assert sum(frame.world_from_camera is not None for frame in frames) == num_true_poses
    assert reader.skipped == {f"{ODD} on {topic}": 1}


def test_with_no_image_left_the_error_says_why(tmp_path: Path) -> None:
    walk = Walk()
    walk.images = [(t, b"no image") for t, _ in walk.images]
    reader = SequenceReader(walk.write(tmp_path / "walk.mcap"))
    with pytest.raises(SequenceError, match=r"no image left of 12 on /camera/.*12 × undecodable.*expected JPEG"):
        list(reader)
