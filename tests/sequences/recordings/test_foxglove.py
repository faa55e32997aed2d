"""Foxglove's messages in each of their encodings, and what is wrong with them."""

import json
import re
import subprocess
import sys
from collections.abc import Callable
from functools import reduce
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import Writer

from filtering.se3 import Poses
from sequences.errors import SequenceError
from sequences.options import SequenceOptions
from sequences.reader import SequenceReader
from tests.helpers.foxglove_files import (
    ENCODINGS,
    Told,
    calibration,
    camera_poses,
    images,
    pose,
    robot,
    transforms,
    write,
)
from tests.helpers.sequence_files import BASE_FROM_CAMERA, BEGIN_NS, CAMERA, picture, rewrite, world_from_camera
from tests.helpers.tf_files import MS, body, stamps


def same(a: Poses | None, b: Poses, tolerance: float = 1e-12) -> bool:
    return a is not None and bool(np.abs(a.as_matrix() - b.as_matrix()).max() < tolerance)


def read(path: Path, **options: Any) -> list:
    return list(SequenceReader(path, SequenceOptions(**options), odometry="unread"))


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_images_poses_and_intrinsics_are_those_written(encoding: str, tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", encoding, images(), calibration(), camera_poses())
    reader = SequenceReader(path, odometry="unread")
    frames = list(reader)
    assert reader.camera == CAMERA
    assert reader.num_images == 12
    assert reader.skipped == {}
    assert [frame.time_ns for frame in frames] == [BEGIN_NS + 100 * MS * i for i in range(12)]
    for i, frame in enumerate(frames):
        np.testing.assert_array_equal(frame.image, picture(i))
        assert same(frame.world_from_camera, world_from_camera(frame.time_ns))


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("topic", ["/transforms", "/tf", "/link"])
def test_odometry_and_true_poses_are_in_transforms_of_any_topic(encoding: str, topic: str, tmp_path: Path) -> None:
    """Also where the camera's mount is told only once, and on topics that are not called /tf."""
    reader = SequenceReader(write(tmp_path / "a.mcap", encoding, images(), robot(topic)))
    frames = list(reader)
    assert same(reader.base_from_camera, BASE_FROM_CAMERA)
    assert len(frames) == 12
    assert frames[0].odometry is None
    for before, frame in pairwise(frames):
        expected = world_from_camera(before.time_ns).inverse() @ world_from_camera(frame.time_ns)
        assert frame.odometry is not None
        assert same(frame.odometry.previous_from_current, expected, 1e-3)  # interpolated over 20 ms
        assert same(frame.world_from_camera, world_from_camera(frame.time_ns), 1e-3)
    assert reader.resolved["odometry_frame"] == "odom"
    assert reader.resolved["ground_truth_frame"] == "map"


def test_a_link_that_moves_late_is_not_taken_for_fixed(tmp_path: Path) -> None:
    """What a camera's mount seems to be at first: one that turns in the end gives no odometry."""
    late_ns = stamps()[-20]
    turned = BASE_FROM_CAMERA @ Poses.exp(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.5]))
    mount = transforms("base_link", "camera", stamps(), lambda t: turned if t >= late_ns else BASE_FROM_CAMERA)
    odometry = transforms("odom", "base_link", stamps(), body)
    frames = list(SequenceReader(write(tmp_path / "a.mcap", "json", images(), mount, odometry)))
    truth = [body(f.time_ns) @ (turned if f.time_ns >= late_ns else BASE_FROM_CAMERA) for f in frames]
    for (_, frame), (a, b) in zip(pairwise(frames), pairwise(truth), strict=True):
        assert frame.odometry is not None
        if not stamps()[-21] < frame.time_ns < late_ns:
            assert same(frame.odometry.previous_from_current, a.inverse() @ b, 1e-3)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_raw_images_are_those_written(encoding: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    pixels = rng.integers(0, 256, (3, 6, 8, 3), dtype=np.uint8)
    told = [
        Told(
            BEGIN_NS + i,
            "/image",
            "RawImage",
            {
                "timestamp": BEGIN_NS + i,
                "frame_id": "camera",
                "width": 8,
                "height": 6,
                "encoding": "bgr8",
                "step": 27,
                "data": np.pad(image[..., ::-1].reshape(6, 24), ((0, 0), (0, 3))).tobytes(),
            },
        )
        for i, image in enumerate(pixels)
    ]
    frames = read(write(tmp_path / "a.mcap", encoding, told))
    np.testing.assert_array_equal([frame.image for frame in frames], pixels)


def poses_in_frame(num_poses: int) -> list[Told]:
    return [
        Told(t, "/path", "PosesInFrame", {"timestamp": t, "frame_id": "map", "poses": [pose(body(t))] * num_poses})
        for t in stamps()
    ]


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_poses_in_frame_are_a_path_of_one_pose_a_message(encoding: str, tmp_path: Path) -> None:
    frames = read(write(tmp_path / "a.mcap", encoding, images(), poses_in_frame(1)), ground_truth_topic="/path")
    assert len(frames) == 12
    assert all(same(frame.world_from_camera, body(frame.time_ns), 1e-3) for frame in frames)
    path = write(tmp_path / "b.mcap", encoding, images(), poses_in_frame(3))
    with pytest.raises(SequenceError, match=r"b\.mcap: /path \(foxglove.*PosesInFrame\): 3 poses of one stamp"):
        read(path, ground_truth_topic="/path")
    assert all(frame.world_from_camera is None for frame in read(path))


def test_libraries_are_loaded_only_for_what_needs_them() -> None:
    code = "import sys, sequences.reader; sys.exit(any(m in sys.modules for m in ('av', 'google.protobuf')))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def changed(source: Path, target: Path, topic: str, change: Callable[[bytes], bytes], index: int = 5) -> Path:
    """A copy in which one message of a topic is changed."""
    damaged_ns = BEGIN_NS + 100 * MS * index
    return rewrite(
        source, target, data=lambda name, t, data: change(data) if (name, t) == (topic, damaged_ns) else data
    )


def edited(edit: Callable[[dict, str], None], names: tuple[str, ...]) -> Callable[[bytes], bytes]:
    """JSON whose field of some path is changed."""

    def change(data: bytes) -> bytes:
        fields = json.loads(data)
        edit(reduce(dict.__getitem__, names[:-1], fields), names[-1])
        return json.dumps(fields).encode()

    return change


def without(*names: str) -> Callable[[bytes], bytes]:
    return edited(dict.__delitem__, names)


def having(value: object, *names: str) -> Callable[[bytes], bytes]:
    return edited(lambda fields, name: fields.update({name: value}), names)


BAD_POSES = {
    "field 'pose' is missing": without("pose"),
    "field 'nsec' is missing": without("timestamp", "nsec"),
    "field 'timestamp' is missing": without("timestamp"),
    "no JSON object": lambda _: b"[1, 2]",
    "no JSON": lambda data: data[:40],
    "not finite": having(float("nan"), "pose", "position", "x"),
    "None where a number is expected": having(None, "pose", "position", "x"),
    "'a' where a whole number is expected": having("a", "timestamp", "sec"),
    "expected one since 1970": having(10**30, "timestamp", "sec"),
    "quaternion of length 0": having({"x": 0, "y": 0, "z": 0, "w": 0}, "pose", "orientation"),
    "3 where text is expected": having(3, "frame_id"),
}


@pytest.mark.parametrize("said", BAD_POSES)
def test_a_bad_pose_in_json_is_left_out_and_one_line_names_it(said: str, tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", "json", images(), camera_poses())
    reader = SequenceReader(changed(path, tmp_path / "bad.mcap", "/pose", BAD_POSES[said]), odometry="unread")
    assert len(list(reader)) == 12
    (notice,) = (notice for notice in reader.notices if "left out" in notice)
    assert re.fullmatch(rf"1 of \d+ true poses left out, the first: .*: /pose at \d+ ns: .*{said}.*", notice)


BAD_IMAGES = {
    "wrong base64": having("a%b", "data"),
    "bytes that are no base64 of an image": having("abcd", "data"),
    "data left out": without("data"),
    "no object": lambda _: b"3",
}


@pytest.mark.parametrize("what", BAD_IMAGES)
def test_a_bad_image_in_json_is_counted(what: str, tmp_path: Path) -> None:
    path = changed(write(tmp_path / "a.mcap", "json", images()), tmp_path / "b.mcap", "/camera/image", BAD_IMAGES[what])
    reader = SequenceReader(path, odometry="unread")
    assert len(list(reader)) == 11
    assert reader.skipped == {"undecodable image": 1}


def test_truncated_protobuf_is_counted_for_images_and_for_poses(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", "protobuf", images(), camera_poses())
    reader = SequenceReader(
        changed(path, tmp_path / "image.mcap", "/camera/image", lambda data: data[:-20]), odometry="unread"
    )
    assert len(list(reader)) == 11
    assert reader.skipped == {"undecodable image": 1}
    bad_pose = changed(path, tmp_path / "pose.mcap", "/pose", lambda data: data[:-5])
    no_stamp = changed(path, tmp_path / "stamp.mcap", "/pose", lambda _: b"")
    for bad, said in [(bad_pose, "no foxglove.PoseInFrame"), (no_stamp, "field 'timestamp' is missing")]:
        reader = SequenceReader(bad, odometry="unread")
        assert len(list(reader)) == 12
        assert any("/pose at" in notice and said in notice for notice in reader.notices)


@pytest.mark.parametrize(("number", "said"), [(0, None), (4, "K has 4 numbers, expected 9")])
def test_intrinsics_need_nine_numbers_or_none(number: int, said: str | None, tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", "protobuf", images(), calibration(K=[1.0] * number))
    if said is None:
        assert SequenceReader(path, odometry="unread").camera is None
        return
    with pytest.raises(SequenceError, match=r"no readable message on /camera/calibration"):
        SequenceReader(path, odometry="unread")


@pytest.mark.parametrize(
    ("encoding", "definition", "said"),
    [
        ("flatbuffer", b"", r"\(foxglove\.CompressedImage\) is encoded as 'flatbuffer', expected 'protobuf' or 'json'"),
        ("cdr", b"", r"is encoded as 'cdr', expected 'protobuf' or 'json'"),
        ("protobuf", b"rubbish", r"no readable message|no image left"),
        ("protobuf", b"", r"no readable message|no image left"),
    ],
)
def test_other_encodings_and_damaged_definitions_are_named(
    encoding: str, definition: bytes, said: str, tmp_path: Path
) -> None:
    path = tmp_path / "a.mcap"
    with open(path, "wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("foxglove.CompressedImage", encoding, definition)
        channel = writer.register_channel("/image", encoding, schema)
        writer.add_message(channel, BEGIN_NS, b"abc", BEGIN_NS)
        writer.finish()
    with pytest.raises(SequenceError, match=said) as refusal:
        read(path)
    assert "\n" not in str(refusal.value)
