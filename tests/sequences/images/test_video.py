"""Video in recordings: packets -> images at their stamps, and what is lost where packets are damaged or missing."""

import sys
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sequences.errors import SequenceError
from sequences.frame import Frame
from sequences.images.decoding import decode_image
from sequences.images.video import BEFORE_KEY_FRAME, DAMAGED
from sequences.options import SequenceOptions
from sequences.reader import SequenceReader
from sequences.reading.counts import OUTSIDE
from tests.helpers import foxglove_files, tf_files
from tests.helpers.sequence_files import BASE_FROM_CAMERA, rewrite, world_from_camera
from tests.helpers.tf_files import MS, image_message
from tests.helpers.video_files import GROUP, NUM, TOPIC, Packet, encode, ffmpeg_packets, pictures, stamp, video


def read(path: Path, **options: Any) -> tuple[list[Frame], dict[str, int]]:
    reader = SequenceReader(path, SequenceOptions(**options), odometry="unread")
    return list(reader), dict(reader.skipped)


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    return 10 * np.log10(255**2 / np.mean((a.astype(float) - b) ** 2))


def require(frames: list[Frame], indices: list[int], images: np.ndarray | None = None) -> None:
    """The frames are those images, at their stamps, and no others."""
    images = pictures() if images is None else images
    assert [frame.time_ns for frame in frames] == [stamp(i) for i in indices]
    for i, frame in zip(indices, frames, strict=True):
        likeness = [psnr(frame.image, image) for image in images]
        assert likeness[i] > 32
        assert likeness[i] - max(x for j, x in enumerate(likeness) if j != i) > 10


@pytest.fixture(scope="module")
def h264() -> list[Packet]:
    return encode(pictures())


@pytest.fixture(scope="module")
def h264_reordered() -> list[Packet]:
    packets = encode(pictures(), b_frames=2)
    assert [i for i, _ in packets] != list(range(NUM))
    return packets


@pytest.mark.parametrize("encoding", foxglove_files.ENCODINGS)
def test_every_packet_is_an_image_at_its_stamp(encoding: str, h264: list[Packet], tmp_path: Path) -> None:
    frames, skipped = read(foxglove_files.write(tmp_path / "a.mcap", encoding, video(h264)))
    require(frames, list(range(NUM)))
    assert skipped == {}


@pytest.mark.parametrize("encoding", ["libx264", "h264_nvenc", "h264;yuv420p;bgr8;bgr8"])
def test_images_come_in_their_order_where_packets_come_in_another(
    encoding: str, h264_reordered: list[Packet], tmp_path: Path
) -> None:
    frames, skipped = read(tf_files.record(tmp_path / "a.mcap", ffmpeg_packets(h264_reordered, encoding)))
    require(frames, list(range(NUM)))
    assert skipped == {}


@pytest.mark.parametrize(
    ("encoder", "video_format"), [("libx265", "h265"), ("libvpx-vp9", "vp9"), ("libsvtav1", "av1")]
)
def test_other_codecs_are_read(encoder: str, video_format: str, tmp_path: Path) -> None:
    packets = encode(pictures(), encoder)
    frames, skipped = read(foxglove_files.write(tmp_path / "a.mcap", "protobuf", video(packets, video_format)))
    require(frames, list(range(NUM)))
    assert skipped == {}


@pytest.mark.parametrize("reordered", [False, True])
def test_odometry_and_true_poses_belong_to_the_images(reordered: bool, request: Any, tmp_path: Path) -> None:
    packets = request.getfixturevalue("h264_reordered" if reordered else "h264")
    times_ns = tf_files.stamps(NUM)
    moving = foxglove_files.transforms("odom", "base_link", times_ns, tf_files.body)
    mount = foxglove_files.transforms("base_link", "camera", times_ns[:1], lambda _: BASE_FROM_CAMERA)
    poses = foxglove_files.camera_poses(NUM)
    reader = SequenceReader(foxglove_files.write(tmp_path / "a.mcap", "protobuf", video(packets), moving, mount, poses))
    frames = list(reader)
    require(frames, list(range(NUM)))
    for before, frame in pairwise(frames):
        assert frame.odometry is not None
        assert frame.world_from_camera is not None
        expected = world_from_camera(before.time_ns).inverse() @ world_from_camera(frame.time_ns)
        assert np.abs(frame.odometry.previous_from_current.as_matrix() - expected.as_matrix()).max() < 1e-3
        assert max(frame.world_from_camera.distance(world_from_camera(frame.time_ns))) < 1e-9


def test_a_segment_may_begin_between_key_frames(h264_reordered: list[Packet], tmp_path: Path) -> None:
    path = foxglove_files.write(tmp_path / "a.mcap", "protobuf", video(h264_reordered))
    frames, skipped = read(path, start_s=0.25, duration_s=0.6)
    require(frames, list(range(3, 9)))
    assert skipped == {OUTSIDE: NUM - 6}


def test_a_stream_may_change_its_size_and_its_codec(h264: list[Packet], tmp_path: Path) -> None:
    wide = pictures(width=128, height=48)
    packets = h264[:GROUP] + encode(wide)[GROUP : 2 * GROUP]
    hevc = encode(pictures(), "libx265")[2 * GROUP :]
    told = video(packets) + [t._replace(time_ns=t.fields["timestamp"] + 20 * MS) for t in video(hevc, "h265")]
    frames, skipped = read(foxglove_files.write(tmp_path / "a.mcap", "protobuf", told))
    assert skipped == {}
    assert [frame.image.shape[:2] for frame in frames] == [(64, 96)] * 6 + [(48, 128)] * 6 + [(64, 96)] * 2
    require(frames[:6], list(range(6)))
    require(frames[6:12], list(range(6, 12)), wide)
    require(frames[12:], [12, 13])


@pytest.mark.parametrize("ros_encoding", ["mono8", "bayer_rggb8"])
def test_one_channel_in_luma_is_taken_as_it_is(ros_encoding: str, tmp_path: Path) -> None:
    """As ffmpeg_image_transport packs it; as video of the narrow range, black and white would lie beyond them."""
    grey = np.random.default_rng(0).integers(0, 256, (6, 64, 96), dtype=np.uint8)
    packets = encode(grey, "libx264", pixels="gray", crf="0")
    path = tf_files.record(tmp_path / "a.mcap", ffmpeg_packets(packets, f"h264;gray;{ros_encoding};{ros_encoding}"))
    frames, _ = read(path)
    for image, frame in zip(grey, frames, strict=True):
        np.testing.assert_array_equal(frame.image, decode_image(image_message(image, ros_encoding)))


@pytest.mark.parametrize("reordered", [False, True])
def test_images_before_the_first_key_frame_are_counted(reordered: bool, request: Any, tmp_path: Path) -> None:
    packets = request.getfixturevalue("h264_reordered" if reordered else "h264")[4:]
    assert (
        packets[0][0] > packets[1][0]
    ) == reordered  # the recording begins with a packet that is not of its first image
    frames, skipped = read(foxglove_files.write(tmp_path / "a.mcap", "protobuf", video(packets)))
    require(frames, list(range(GROUP, NUM)))
    assert skipped == {BEFORE_KEY_FRAME: GROUP - 4}


DAMAGES: dict[str, Callable[[bytes], bytes]] = {
    "cut off": lambda data: data[: len(data) // 2],
    "rubbish": lambda data: bytes(range(1, 100)),
    "overwritten": lambda data: data[:30] + bytes(len(data) - 30),
    "empty": lambda data: b"",
}


@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize("reordered", [False, True])
def test_nothing_is_made_up_after_a_damaged_packet(reordered: bool, damage: str, request: Any, tmp_path: Path) -> None:
    """Where packets are reordered, the second is one that the images before its own are built on."""
    packets = list(request.getfixturevalue("h264_reordered" if reordered else "h264"))
    position = 1 if reordered else 3
    which, data = packets[position]
    packets[position] = (which, DAMAGES[damage](data))
    frames, skipped = read(foxglove_files.write(tmp_path / "a.mcap", "protobuf", video(packets)))
    require(frames, [*range(position), *range(GROUP, NUM)])
    assert skipped == {DAMAGED: GROUP - position}


def test_a_message_that_is_none_breaks_the_video_as_well(h264: list[Packet], tmp_path: Path) -> None:
    source = foxglove_files.write(tmp_path / "a.mcap", "protobuf", video(h264))
    damaged_ns = stamp(2) + 20 * MS
    path = rewrite(source, tmp_path / "b.mcap", data=lambda _, t, data: data[:-9] if t == damaged_ns else data)
    frames, skipped = read(path)
    require(frames, [0, 1, *range(GROUP, NUM)])
    assert skipped == {"undecodable image": 1, DAMAGED: GROUP - 3}


@pytest.mark.parametrize(("encoder", "video_format"), [("libx264", "h264"), ("libx265", "h265"), ("libvpx-vp9", "vp9")])
def test_video_of_more_pixels_than_allowed_is_not_decoded(
    encoder: str, video_format: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = foxglove_files.write(tmp_path / "a.mcap", "protobuf", video(encode(pictures(3), encoder), video_format))
    monkeypatch.setattr("sequences.images.video.MAX_PIXELS", 4 * 96 * 64)  # the decoder counts rows as it aligns them
    assert len(list(SequenceReader(path, odometry="unread"))) == 3
    monkeypatch.setattr("sequences.images.video.MAX_PIXELS", 96 * 64 - 1)
    with pytest.raises(SequenceError, match="no image left of 3"):
        list(SequenceReader(path, odometry="unread"))


def test_an_unknown_format_is_named(h264: list[Packet], tmp_path: Path) -> None:
    path = foxglove_files.write(tmp_path / "a.mcap", "protobuf", video(h264, "theora"))
    with pytest.raises(
        SequenceError, match=r"14 × undecodable image.*format 'theora' cannot be decoded, expected H\.264"
    ):
        read(path)


def test_without_pyav_it_is_said_what_to_install(
    h264: list[Packet], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = foxglove_files.write(tmp_path / "a.mcap", "protobuf", video(h264))
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(SequenceError, match=rf"a\.mcap: {TOPIC} \(foxglove\.Comp.*pip install 'vapor-track\[video\]'"):
        read(path)
