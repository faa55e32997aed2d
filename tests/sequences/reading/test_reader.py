"""Recorded sequences -> frames, in every form in which they lie on disk."""

import tracemalloc
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.writer import Writer

from sequences.errors import SequenceError
from sequences.options import SequenceOptions
from sequences.reader import SequenceReader
from sequences.reading.counts import OUTSIDE
from sequences.recordings.message_definitions import schema_name, schema_text
from tests.helpers.sequence_files import (
    BASE_FROM_CAMERA,
    BEGIN_NS,
    CAMERA,
    FORMS,
    IMAGES,
    TWIST_COVARIANCE,
    Form,
    Walk,
    as_file_without_index,
    close,
    picture,
    rewrite,
    world_from_camera,
)


@pytest.mark.parametrize("form", FORMS)
def test_frames_are_what_was_written_in_every_form(form: Form, walk_file: Path, tmp_path: Path) -> None:
    reader = SequenceReader(form(walk_file, tmp_path))
    frames = list(reader)
    assert [f.time_ns for f in frames] == [BEGIN_NS + 100_000_000 * i for i in range(12)]
    assert [f.time_ns for f in reader] == [f.time_ns for f in frames]  # again
    assert reader.num_images == 12
    assert reader.camera == CAMERA
    assert close(reader.base_from_camera, BASE_FROM_CAMERA, 1e-12)
    assert reader.skipped == {}
    for i, frame in enumerate(frames):
        np.testing.assert_array_equal(frame.image, picture(i))
        assert frame.camera == CAMERA
        assert close(frame.world_from_camera, world_from_camera(frame.time_ns), 1e-12)
    assert frames[0].odometry is None
    for before, frame in pairwise(frames):
        truth = world_from_camera(before.time_ns).inverse() @ world_from_camera(frame.time_ns)
        assert frame.odometry is not None
        # Between messages 20 ms apart the walk is not quite of constant velocity.
        assert close(frame.odometry.previous_from_current, truth, 1e-4)
        assert truth.log()[:3] @ truth.log()[:3] > 1e-4
        # Five intervals of 20 ms; a turn of 0.1 s changes little.
        carry = BASE_FROM_CAMERA.inverse().adjoint()
        expected = carry @ TWIST_COVARIANCE @ carry.T * 5 * 0.02**2
        np.testing.assert_allclose(frame.odometry.covariance, expected, atol=0.02 * np.abs(expected).max())


def test_the_file_says_where_its_odometry_comes_from(walk_file: Path, tmp_path: Path) -> None:
    assert SequenceReader(walk_file).odometry_description == "simulated: exact"
    silent = SequenceReader(Walk().write(tmp_path / "silent.mcap"))
    assert silent.odometry_description is silent.image_description is None
    rendered = Walk().write(tmp_path / "rendered.mcap", metadata={"images": "synthetic"})
    assert SequenceReader(rendered).image_description == "synthetic"


def test_without_odometry_every_image_is_read(tmp_path: Path) -> None:
    path = rewrite(Walk().write(tmp_path / "in.mcap"), tmp_path / "out.mcap", keep=lambda topic, _: topic != "/odom")
    frames = list(SequenceReader(path, odometry="unread"))
    assert len(frames) == 12
    assert all(frame.odometry is None and frame.world_from_camera is not None for frame in frames)
    with pytest.raises(SequenceError, match=r"no odometry topic.*nav_msgs/Odometry.*/tf_static \(tf2_msgs/TFMessage\)"):
        SequenceReader(path)


def test_a_segment_of_a_sequence_is_read(walk_file: Path) -> None:
    reader = SequenceReader(walk_file, SequenceOptions(start_s=0.25, duration_s=0.5))
    assert [f.time_ns for f in reader] == [BEGIN_NS + 100_000_000 * i for i in range(3, 8)]
    assert reader.skipped == {OUTSIDE: 7}


@pytest.mark.parametrize("duration_s", [None, 2.0])
def test_a_segment_behind_the_last_image_is_an_error_that_says_how_long_the_recording_is(
    duration_s: float | None, walk_file: Path
) -> None:
    reader = SequenceReader(walk_file, SequenceOptions(start_s=500.0, duration_s=duration_s))
    with pytest.raises(SequenceError, match=r"the images last 1\.1 s, expected --start-s below that, not 500$"):
        list(reader)


def test_true_poses_are_interpolated_but_not_over_gaps(tmp_path: Path) -> None:
    walk = Walk()
    # True poses at 20 Hz, off the images' stamps, and none between 0.4 and 0.75 s.
    times_ns = [BEGIN_NS + 50_000_000 * i - 20_000_000 for i in range(26) if not 9 <= i <= 15]
    walk.truth = [(t, world_from_camera(t)) for t in times_ns]
    frames = list(SequenceReader(walk.write(tmp_path / "walk.mcap")))
    assert len(frames) == 12
    for i, frame in enumerate(frames):
        if i in (4, 5, 6, 7):
            assert frame.world_from_camera is None
        else:
            assert close(frame.world_from_camera, world_from_camera(frame.time_ns), 1e-3)


def test_odometry_logged_late_is_waited_for(tmp_path: Path) -> None:
    def late(topic: str, time_ns: int) -> int:
        return time_ns + 300_000_000 * (topic == "/odom")

    path = rewrite(Walk().write(tmp_path / "in.mcap"), tmp_path / "out.mcap", log_time=late)
    with open(path, "rb") as file:
        order = [channel.topic for _, channel, _ in make_reader(file).iter_messages([IMAGES, "/odom"])]
    assert order[:3] == [IMAGES] * 3  # the precondition
    assert len(list(SequenceReader(path))) == 12


def test_raw_images_are_read_and_beside_compressed_ones_must_be_named(tmp_path: Path) -> None:
    path = tmp_path / "raw.mcap"
    rows = np.concatenate([picture(3)[..., ::-1].reshape(CAMERA.height, -1), np.zeros((CAMERA.height, 6), np.uint8)], 1)
    with open(path, "wb") as file, Writer(file) as writer:
        types = ("sensor_msgs/Image", "sensor_msgs/CompressedImage", "nav_msgs/Odometry")
        raw, compressed, odometry = (writer.register_msgdef(schema_name(t), schema_text(t)) for t in types)
        for i in range(4):
            stamp = {"sec": 5, "nanosec": i * 50_000_000}
            pose = {"pose": {"position": {"x": 0.1 * i}, "orientation": {"w": 1.0}}}
            message = {"header": {"stamp": stamp}, "child_frame_id": "camera", "pose": pose}
            writer.write_message("/vo", odometry, message, log_time=i)
            header = {"stamp": stamp, "frame_id": "/camera"}
            size = {"height": CAMERA.height, "width": CAMERA.width, "step": rows.shape[1]}
            image = {"header": header, "encoding": "bgr8", "data": rows.tobytes(), **size}
            writer.write_message("/camera/image_raw", raw, image, log_time=i)
            writer.write_message("/camera/image_raw/compressed", compressed, {"header": header}, log_time=i)
    with pytest.raises(SequenceError, match=r"2 image topics.*/camera/image_raw \(sensor_msgs/Image\)"):
        SequenceReader(path)
    reader = SequenceReader(path, SequenceOptions(image_topic="/camera/image_raw"))
    frames = list(reader)
    assert len(frames) == 4
    assert reader.camera is None
    for frame in frames:
        np.testing.assert_array_equal(frame.image, picture(3))
        assert frame.world_from_camera is None
    assert frames[3].odometry is not None
    np.testing.assert_allclose(frames[3].odometry.previous_from_current.translation, [0.1, 0, 0], atol=1e-12)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("with_index", [True, False])
def test_memory_does_not_grow_with_the_file(with_index: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sequences.recordings.mcap_file._MAX_KEPT_BYTES", 0)
    monkeypatch.setattr("sequences.reading.frame_pairing._HORIZON_NS", 10**9)
    rng = np.random.default_rng(0)
    peaks, sizes = [], []
    for num_images in (50, 200):
        walk = Walk(num_images)
        # PNG files with 100 kB of rubbish behind their end: large on disk, quick to decode.
        walk.images = [(t, data + rng.bytes(100_000)) for t, data in walk.images]
        walk.odometry = walk.odometry[::4]
        path = walk.write(tmp_path / f"{num_images}.mcap")
        reader = SequenceReader(path if with_index else as_file_without_index(path, tmp_path))
        assert next(iter(reader)) is not None  # decoders are made once and kept
        tracemalloc.start()
        assert sum(1 for _ in reader) == num_images
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        sizes.append(path.stat().st_size)
    assert sizes[1] > 3.9 * sizes[0]
    assert peaks[1] < 1.1 * peaks[0]
    assert peaks[1] < 0.5 * sizes[1]
