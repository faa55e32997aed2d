"""Recordings of several cameras."""

import struct
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from filtering.se3 import Poses
from sequences.errors import NotFoundError, SequenceError
from sequences.options import SequenceOptions
from sequences.reader import SequenceReader
from sequences.recordings.mcap_writer import ros_transform
from sequences.recordings.message_definitions import decoder, encoder
from tests.helpers.rigs import CAMERA_FROM_LEFT, CAMERA_FROM_RIGHT, FRONT, LEFT, NARROW, RIGHT, WIDE, Rig
from tests.helpers.sequence_files import BEGIN_NS, CAMERA, MS, Walk, close, rewrite, world_from_camera

TOGETHER = Rig({"left": 0, "right": 0}, {})
APART = Rig({"left": 50 * MS, "right": 0}, {"right": 5})
MOUNTS = {FRONT: Poses.identity(), LEFT: CAMERA_FROM_LEFT, RIGHT: CAMERA_FROM_RIGHT}


@pytest.mark.parametrize("rig", [TOGETHER, APART])
def test_images_of_all_cameras_come_in_order_of_time_with_the_motion_of_the_first(rig: Rig, tmp_path: Path) -> None:
    reader = SequenceReader(rig.write(tmp_path / "rig.mcap"))
    frames = list(reader)
    assert reader.camera_names == (FRONT, LEFT, RIGHT)
    assert {frame.camera_name for frame in frames} == {FRONT, LEFT, RIGHT}
    assert all(one.time_ns < other.time_ns for one, other in pairwise(frames))
    assert reader.counts.are_complete
    assert reader.counts.used == len(frames) == reader.num_images
    assert f"true poses of /ground_truth/pose are taken for those of {FRONT}" in reader.notices[0]
    travelled = world_from_camera(frames[0].time_ns)
    for number, frame in enumerate(frames):
        assert frame.world_from_camera is not None
        assert frame.world_from_reference is not None
        if number:
            assert frame.odometry is not None
            travelled = travelled @ frame.odometry.previous_from_current
        taken_ns = frame.time_ns - frame.time_ns % 1000 + 789 if rig is TOGETHER else frame.time_ns
        assert close(frame.world_from_reference, world_from_camera(taken_ns), 2e-3)  # between poses
        assert close(travelled, world_from_camera(taken_ns), 5e-3)
        assert close(frame.world_from_camera, frame.world_from_reference @ MOUNTS[frame.camera_name], 1e-9)
        assert (frame.reference_from_camera is None) == (frame.camera_name == FRONT)


def test_each_camera_has_its_own_intrinsics(tmp_path: Path) -> None:
    frames = list(SequenceReader(TOGETHER.write(tmp_path / "rig.mcap")))
    for frame in frames:
        assert frame.camera == {FRONT: CAMERA, LEFT: WIDE, RIGHT: NARROW}[frame.camera_name]
        assert frame.image.shape[:2] == (frame.camera.height, frame.camera.width)


def test_images_of_one_moment_are_frames_a_nanosecond_apart(tmp_path: Path) -> None:
    frames = list(SequenceReader(TOGETHER.write(tmp_path / "rig.mcap")))
    moments = [frames[i : i + 3] for i in range(0, len(frames), 3)]
    assert all(moment[2].time_ns - moment[0].time_ns == 2 for moment in moments)
    for moment in moments[1:]:
        assert moment[1].odometry is not None
        assert moment[1].odometry.duration_s == 0.0
        assert close(moment[1].odometry.previous_from_current, Poses.identity(), 1e-9)


def test_the_camera_named_first_is_the_one_that_is_localized(tmp_path: Path) -> None:
    path = TOGETHER.write(tmp_path / "rig.mcap")
    reader = SequenceReader(path, SequenceOptions(image_topic=f"{LEFT}, {FRONT}", ground_truth_topic=""))
    frames = list(reader)
    assert reader.camera_names == (LEFT, FRONT)
    assert reader.camera == WIDE
    assert [frame.camera_name for frame in frames[:4]] == [FRONT, LEFT] * 2  # as they were recorded
    motion = frames[2].odometry
    assert motion is not None
    begin, end = (world_from_camera(frame.time_ns) @ CAMERA_FROM_LEFT for frame in (frames[0], frames[2]))
    assert close(motion.previous_from_current, begin.inverse() @ end, 5e-3)
    mount = frames[0].reference_from_camera
    assert mount is not None
    assert close(mount, CAMERA_FROM_LEFT.inverse(), 1e-9)
    assert frames[1].reference_from_camera is None
    assert reader.resolved["image_topic"] == f"{LEFT},{FRONT}"


def test_one_camera_of_several_is_read_alone_where_it_is_the_only_one_named(tmp_path: Path) -> None:
    path = TOGETHER.write(tmp_path / "rig.mcap")
    frames = list(SequenceReader(path, SequenceOptions(image_topic=RIGHT, ground_truth_topic="")))
    assert [frame.camera_name for frame in frames] == [""] * 12
    assert all(frame.reference_from_camera is None for frame in frames)


def test_the_cameras_that_a_model_knows_are_taken_where_none_is_named(tmp_path: Path) -> None:
    path = TOGETHER.write(tmp_path / "rig.mcap")
    some = SequenceReader(path, usual_cameras=[RIGHT, "/elsewhere"])
    assert some.camera_names == (RIGHT,)
    assert f"images of {FRONT}, {LEFT} are not used, as the model did not learn from them" in some.notices
    assert "no images of /elsewhere, which the model learned from, too" in some.notices
    assert SequenceReader(path, usual_cameras=["/elsewhere"]).camera_names == (FRONT, LEFT, RIGHT)
    named = SequenceOptions(image_topic=FRONT)
    assert SequenceReader(path, named, usual_cameras=[RIGHT]).camera_names == (FRONT,)


def test_one_of_several_cameras_keeps_its_mount_and_its_own_true_pose(tmp_path: Path) -> None:
    path = TOGETHER.write(tmp_path / "rig.mcap")
    all_of_them = [frame for frame in SequenceReader(path) if frame.camera_name == LEFT]
    alone = SequenceReader(path, only_camera=LEFT)
    frames = list(alone)
    assert alone.num_images == 12
    assert alone.camera == WIDE
    for frame, other in zip(frames, all_of_them, strict=True):
        assert frame.world_from_camera is not None
        assert other.world_from_camera is not None
        assert close(frame.world_from_camera, other.world_from_camera, 2e-3)
        assert frame.camera_name == LEFT


def test_a_camera_of_which_no_image_can_be_decoded_is_left_out_and_told(tmp_path: Path) -> None:
    reader = SequenceReader(TOGETHER.write(tmp_path / "rig.mcap", spoilt="left"))
    frames = list(reader)
    assert {frame.camera_name for frame in frames} == {FRONT, RIGHT}
    assert reader.counts.are_complete
    assert reader.skipped.total() == 12
    assert f"{LEFT}: none of its images could be used, so that camera is left out" in reader.notices


def test_depth_and_grey_images_beside_images_in_colour_are_no_cameras(tmp_path: Path) -> None:
    source = TOGETHER.write(tmp_path / "in.mcap")

    def formatted(topic: str, time_ns: int, data: bytes) -> bytes:
        if topic not in (LEFT, RIGHT):
            return data
        message = decoder("sensor_msgs/CompressedImage")(data)
        message.format = "16UC1; png compressed " if topic == LEFT else "mono8; png compressed "
        stamp = {"sec": message.header.stamp.sec, "nanosec": message.header.stamp.nanosec}
        header = {"stamp": stamp, "frame_id": message.header.frame_id}
        fields = {"header": header, "format": message.format, "data": bytes(message.data)}
        return encoder("sensor_msgs/CompressedImage")(fields)

    reader = SequenceReader(rewrite(source, tmp_path / "out.mcap", data=formatted))
    assert reader.camera_names == (FRONT,)
    said = [each for each in reader.notices if "are not used" in each]
    assert [each.split(": ")[0] for each in said] == [
        f"images of {LEFT} are not used (depth)",
        f"images of {RIGHT} are not used (grey)",
    ]


def test_cameras_that_no_transforms_connect_are_a_choice_to_make(tmp_path: Path) -> None:
    path = rewrite(TOGETHER.write(tmp_path / "in.mcap"), tmp_path / "out.mcap", keep=lambda t, _: t != "/tf_static")
    with pytest.raises(
        SequenceError,
        match=rf"3 image topics, and no transforms between 'camera_optical_frame' .*left.*: --image-topic {FRONT}",
    ):
        SequenceReader(path, odometry="unread")
    with pytest.raises(NotFoundError, match=r"no transform from 'camera_optical_frame'.*single --image-topic"):
        SequenceReader(path, SequenceOptions(image_topic=f"{FRONT},{LEFT}"), odometry="unread")


@pytest.mark.parametrize("topic", [f"{FRONT},{FRONT}", f"{FRONT},", ",", f"{FRONT},,{LEFT}"])
def test_a_list_of_cameras_names_each_once(topic: str) -> None:
    with pytest.raises(SequenceError, match="expected names separated by commas, each once"):
        SequenceOptions(image_topic=topic)


def test_a_segment_and_a_repetition_give_the_same_images_of_all_cameras(tmp_path: Path) -> None:
    path = APART.write(tmp_path / "rig.mcap", Walk(30))
    whole = list(SequenceReader(path))
    reader = SequenceReader(path, SequenceOptions(start_s=0.45, duration_s=1.2))
    for _ in range(2):
        part = list(reader)
        assert reader.counts.are_complete
        begin = whole[0].time_ns
        expected = [f for f in whole if 0.45e9 <= f.time_ns - begin <= 1.65e9]
        assert [(f.time_ns, f.camera_name) for f in part] == [(f.time_ns, f.camera_name) for f in expected]
        for one, other in zip(part[1:], expected[1:], strict=True):
            np.testing.assert_array_equal(one.image, other.image)


def test_a_camera_that_moves_on_the_first_is_refused(tmp_path: Path) -> None:
    source = TOGETHER.write(tmp_path / "in.mcap")
    number = iter(range(100))

    def moved(topic: str, time_ns: int, data: bytes) -> bytes:
        if topic != "/tf_static":
            return data
        message = decoder("tf2_msgs/TFMessage")(data)
        later, transforms = next(number), []
        for t in message.transforms:
            is_left = t.child_frame_id.startswith("left")
            at, turned = t.transform.translation, t.transform.rotation
            values = [at.x + 0.5 * later * is_left, at.y, at.z, turned.x, turned.y, turned.z, turned.w]
            transforms.append(ros_transform(time_ns, t.header.frame_id, t.child_frame_id, np.array(values)))
        return encoder("tf2_msgs/TFMessage")({"transforms": transforms})

    folder = tmp_path / "bag"
    folder.mkdir()
    rewrite(source, folder / "a.mcap", data=moved)
    end = BEGIN_NS + 600 * MS
    rewrite(source, folder / "b.mcap", keep=lambda t, _: t == "/tf_static", data=moved, log_time=lambda t, ns: end)
    (folder / "metadata.yaml").write_text("relative_file_paths:\n- a.mcap\n- b.mcap\n")
    with pytest.raises(SequenceError, match=r"left_optical_frame has moved by 0.5 m"):
        list(SequenceReader(folder))


@pytest.mark.parametrize("by_s", [14.0, -14.0])
def test_a_camera_by_another_clock_is_left_out_and_takes_nothing_from_the_others(by_s: float, tmp_path: Path) -> None:
    source = TOGETHER.write(tmp_path / "in.mcap")

    def shifted(topic: str, time_ns: int, data: bytes) -> bytes:
        if topic != LEFT:
            return data
        stamp = divmod(time_ns + round(by_s * 1e9), 10**9)
        return data[:4] + struct.pack("<iI", *stamp) + data[12:]

    reader = SequenceReader(rewrite(source, tmp_path / "out.mcap", data=shifted))
    frames = list(reader)
    assert {frame.camera_name for frame in frames} == {FRONT, RIGHT}
    assert len(frames) == reader.counts.used == 24
    assert reader.counts.are_complete
    (notice,) = [each for each in reader.notices if each.startswith(LEFT)]
    assert f"its stamps are 14.0 s {'ahead of' if by_s > 0 else 'behind'} those of {FRONT}" in notice


def test_an_unknown_camera_alone_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(SequenceError, match=f"no camera /elsewhere, found {FRONT}"):
        SequenceReader(TOGETHER.write(tmp_path / "rig.mcap"), only_camera="/elsewhere")


def test_stamps_a_nanosecond_apart_give_frames_in_order(tmp_path: Path) -> None:
    rig = Rig({"left": 0, "right": 1}, {})
    frames = list(SequenceReader(rig.write(tmp_path / "rig.mcap")))
    assert len(frames) == 35
    assert all(one.time_ns < other.time_ns for one, other in pairwise(frames))
