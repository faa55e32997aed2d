"""Videos and folders of images as sequences: their stamps, what is left out, and what cannot be read."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from filtering.errors import VaporTrackError
from sequences.datasets.frames import posed_frames
from sequences.errors import SequenceError
from sequences.frame import Camera
from sequences.image_sequence import ImageSequence, is_image_sequence
from sequences.options import SequenceOptions
from tests.helpers.data_sets import STEP_NS, make_7scenes, make_tum, same
from tests.helpers.video_clips import held_upright, write_clip
from tests.helpers.video_files import pictures
from vapor.pipeline.config import RunConfig

TIMES_MS = [0, 33, 66, 500, 533, 1000, 1010]  # frames that a phone took as it could
CAMERA = {"width": 192, "height": 128, "fx": 150.0, "fy": 150.0, "cx": 95.5, "cy": 63.5}


@pytest.fixture
def clip(tmp_path: Path) -> Path:
    return write_clip(tmp_path / "walk.mp4", pictures(len(TIMES_MS)), TIMES_MS)


def folder_of(path: Path, names: list[str], suffix: str = ".png") -> Path:
    path.mkdir()
    for name, image in zip(names, pictures(len(names)), strict=True):
        cv2.imwrite(str(path / f"{name}{suffix}"), image[:, :, ::-1])
    return path


def stamps_ms(sequence: ImageSequence) -> list[float]:
    return [frame.time_ns * 1e-6 for frame in sequence]


def test_frames_of_a_video_have_its_stamps_and_its_pixels(clip):
    sequence = ImageSequence(clip)
    assert sequence.num_images == len(TIMES_MS)
    frames = list(sequence)
    assert [frame.time_ns for frame in frames] == [1_000_000 * time for time in TIMES_MS]
    for frame, image in zip(frames, pictures(len(TIMES_MS)), strict=True):
        assert np.abs(frame.image.astype(float) - image).mean() < 6.0
        assert frame.odometry is None
        assert frame.world_from_camera is None
    assert sequence.counts.are_complete
    assert sequence.counts.used == len(TIMES_MS)


def test_every_iteration_reads_a_video_again(clip):
    sequence = ImageSequence(clip)
    assert stamps_ms(sequence) == stamps_ms(sequence) == TIMES_MS


def test_a_video_of_a_phone_held_upright_is_upright(clip):
    images = [frame.image for frame in ImageSequence(held_upright(clip))]
    assert images[0].shape == (96, 64, 3)
    stored = pictures(len(TIMES_MS))[0].astype(float)
    assert np.abs(np.rot90(images[0], 1) - stored).mean() < 6.0


def test_a_part_of_a_video_is_read(clip):
    sequence = ImageSequence(clip, SequenceOptions(start_s=0.05, duration_s=0.5))
    assert stamps_ms(sequence) == [66, 500, 533]
    assert sequence.counts.skipped == {"outside the stretch asked for": 4}
    assert sequence.counts.are_complete
    assert sequence.counts.read == 6  # nothing is read behind it
    assert stamps_ms(ImageSequence(clip, SequenceOptions(start_s=0.066, duration_s=0.434))) == [66, 500]
    assert stamps_ms(ImageSequence(clip, SequenceOptions(duration_s=0.0))) == [0]


def test_images_outside_the_part_that_is_read_are_not_decoded(tmp_path):
    folder = folder_of(tmp_path / "images", [str(i) for i in range(10)])
    for i in (0, 1, 2, 6, 7, 8, 9):
        (folder / f"{i}.png").write_bytes(b"no image")
    sequence = ImageSequence(folder, SequenceOptions(start_s=3.0, duration_s=2.0), rate_hz=1.0)
    assert stamps_ms(sequence) == [3000, 4000, 5000]
    assert sequence.counts.skipped == {"outside the stretch asked for": 7}


def test_most_images_of_a_folder_must_be_readable(tmp_path):
    folder = folder_of(tmp_path / "images", [str(i) for i in range(5)])
    for i in range(3):
        (folder / f"{i}.png").write_bytes(b"no image")
    with pytest.raises(SequenceError, match="3 of 5 images cannot be used"):
        list(ImageSequence(folder))


def test_a_video_that_is_cut_off_says_so(tmp_path):
    clip = write_clip(tmp_path / "walk.mkv", pictures(40), range(0, 1600, 40))
    clip.write_bytes(clip.read_bytes()[: clip.stat().st_size // 2])
    sequence = ImageSequence(clip)
    count = len(list(sequence))
    assert 0 < count < 38
    assert any(f"{count} could be read" in notice for notice in sequence.notices)


def test_images_of_a_folder_come_in_natural_order_at_a_stated_rate(tmp_path):
    folder = folder_of(tmp_path / "images", [f"frame{i}" for i in range(12)])
    sequence = ImageSequence(folder, rate_hz=10.0)
    frames = list(sequence)
    assert [frame.time_ns for frame in frames] == [100_000_000 * i for i in range(12)]
    for frame, image in zip(frames, pictures(12), strict=True):
        np.testing.assert_array_equal(frame.image, image)
    assert any("10 images a second are assumed" in notice for notice in sequence.notices)


def test_names_that_are_stamps_date_images(tmp_path):
    names = ["1305031102.175304", "1305031102.211214", "1305031103.0", "1305031103.05", "1305031103.1"]
    frames = ImageSequence(folder_of(tmp_path / "rgb", names))
    assert [frame.time_ns for frame in frames] == [
        1305031102175304000, 1305031102211214000, 1305031103000000000, 1305031103050000000, 1305031103100000000,
    ]  # fmt: skip


def test_names_of_which_some_are_stamps_do_not_date_images(tmp_path):
    sequence = ImageSequence(folder_of(tmp_path / "rgb", ["1305031102.175304", "last", "1305031103.0"]), rate_hz=1.0)
    assert stamps_ms(sequence) == [0, 1000, 2000]
    assert any("not all names of the images state time stamps" in notice for notice in sequence.notices)


def test_images_that_cannot_be_decoded_are_counted(tmp_path):
    folder = folder_of(tmp_path / "images", [str(i) for i in range(5)])
    (folder / "2.png").write_bytes((folder / "2.png").read_bytes()[:100])
    sequence = ImageSequence(folder)
    assert len(list(sequence)) == 4
    assert sequence.skipped.total() == 1
    assert any("2.png" in notice for notice in sequence.notices)
    assert sequence.counts.are_complete


def test_intrinsics_beside_the_images_are_scaled_to_them(clip, tmp_path):
    (clip.parent / "intrinsics.json").write_text(json.dumps(CAMERA))
    camera = Camera(**CAMERA).scaled(96, 64)
    sequence = ImageSequence(clip)
    assert sequence.camera == camera
    assert next(iter(sequence)).camera == camera
    (folder := folder_of(tmp_path / "images", ["1", "2"])).joinpath("intrinsics.json").write_text(json.dumps(CAMERA))
    assert ImageSequence(folder).camera == camera


def test_intrinsics_of_another_aspect_ratio_are_refused(clip):
    (clip.parent / "intrinsics.json").write_text(json.dumps({**CAMERA, "width": 128, "height": 192}))
    with pytest.raises(SequenceError, match="of 128 x 192 pixels, the images are of 96 x 64; expected the same aspect"):
        ImageSequence(clip)


def test_images_of_another_aspect_ratio_are_counted(tmp_path):
    folder = folder_of(tmp_path / "images", ["1", "2", "3"])
    (folder / "intrinsics.json").write_text(json.dumps(CAMERA))
    cv2.imwrite(str(folder / "2.png"), pictures(1)[0, :, :50])
    sequence = ImageSequence(folder)
    assert [frame.camera is None for frame in sequence] == [False, True, False]
    assert any("intrinsics of 1 image of another aspect ratio" in notice for notice in sequence.notices)


def test_distortion_is_taken_out_unless_that_is_left_alone(clip):
    (clip.parent / "intrinsics.json").write_text(json.dumps({**CAMERA, "distortion": [0.2, -0.1, 0.0, 0.0]}))
    bent, straight = (
        next(iter(ImageSequence(clip, SequenceOptions(undistort=undistort)))).image for undistort in (False, True)
    )
    assert np.abs(bent.astype(float) - straight).max() > 5.0


def test_images_without_intrinsics_are_said_to_have_none(clip):
    sequence = ImageSequence(clip)
    list(sequence)
    assert sequence.camera is None
    assert any("expected an intrinsics.json beside the images" in notice for notice in sequence.notices)


def test_options_that_do_not_apply_are_refused_by_name(clip):
    with pytest.raises(SequenceError, match="--image-topic, --odometry-topic with images alone"):
        ImageSequence(clip, SequenceOptions(image_topic="/a", odometry_topic="/b"))


@pytest.mark.parametrize("rate_hz", [0.0, -1.0, float("nan"), float("inf")])
def test_an_impossible_rate_is_refused(rate_hz, tmp_path):
    with pytest.raises(VaporTrackError, match="rate_hz"):
        RunConfig(rate_hz=rate_hz)
    with pytest.raises(VaporTrackError, match="rate_hz"):
        ImageSequence(folder_of(tmp_path / "images", ["1"]), rate_hz=rate_hz)


def test_what_is_no_video_is_refused(tmp_path):
    (tmp_path / "walk.mp4").write_bytes(b"no video at all")
    with pytest.raises(SequenceError, match=r"walk\.mp4: cannot be opened as a video"):
        ImageSequence(tmp_path / "walk.mp4")
    with pytest.raises(SequenceError, match=r"none\.mp4: no such file, expected a video"):
        ImageSequence(tmp_path / "none.mp4")
    with pytest.raises(SequenceError, match="no sequence or data set; looked for a video, PNG or JPEG"):
        ImageSequence(tmp_path)
    (tmp_path / "notes.txt").write_text("bread\n")
    with pytest.raises(SequenceError, match=r"notes\.txt: is a file, expected the folder of a data set or the list"):
        ImageSequence(tmp_path / "notes.txt")


def test_a_segment_without_images_is_an_error(clip):
    lasts = rf"the images last {TIMES_MS[-1] / 1000:.1f} s, expected --start-s below that, not 60$"
    with pytest.raises(SequenceError, match=f"no image is left: 7 × outside the stretch asked for; {lasts}"):
        list(ImageSequence(clip, SequenceOptions(start_s=60.0)))


def test_recordings_are_no_image_sequences(clip, tmp_path):
    folder = folder_of(tmp_path / "images", ["1", "2"])
    assert is_image_sequence(clip)
    assert is_image_sequence(folder)
    assert not is_image_sequence(tmp_path / "walk.mcap")
    (folder / "walk.mcap").write_bytes(b"")
    assert not is_image_sequence(folder)  # whose images are previews
    (folder / "walk.mcap").rename(folder / "WALK.MCAP")
    assert not is_image_sequence(folder)
    (folder / "WALK.MCAP").rename(folder / "metadata.yaml")
    assert not is_image_sequence(folder)


# --- data sets -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("make", [make_tum, make_7scenes])
def test_frames_of_a_data_set_are_those_that_are_trained_on(make, tmp_path):
    data = make(tmp_path / "data")
    assert is_image_sequence(data)
    sequence, expected = ImageSequence(data), list(posed_frames(data))
    frames = list(sequence)
    assert len(frames) == sequence.num_images == 10
    assert [frame.time_ns for frame in frames] == [frame.time_ns for frame in expected]
    for frame, other in zip(frames, expected, strict=True):
        np.testing.assert_array_equal(frame.image, other.image)
        assert same(frame.world_from_camera, other.world_from_camera, 1e-12)
        assert frame.camera == other.camera
    assert sequence.camera == expected[0].camera
    assert sequence.counts.are_complete


def test_a_sequence_of_a_data_set_has_its_poses_where_its_images_lie_beside_them(tmp_path):
    folder = make_7scenes(tmp_path / "scene", num_images=5) / "seq-01"
    for name in ("frame-000001.depth.png", "frame-000003.depth.png"):  # as the data set has them
        cv2.imwrite(str(folder / name), np.zeros((24, 32), np.uint16))
    (folder / "frame-000002.pose.txt").unlink()
    sequence = ImageSequence(folder)
    frames = list(sequence)
    assert [frame.time_ns for frame in frames] == [i * 1_000_000_000 // 30 for i in (0, 1, 3, 4)]
    assert all(frame.world_from_camera is not None for frame in frames)
    assert (sequence.skipped, sequence.counts.are_complete) == ({}, True)
    assert "1 left out of the data set: no true pose" in sequence.notices


def test_a_part_of_a_data_set_has_its_poses_and_the_rate_is_as_asked_for(tmp_path):
    data = make_7scenes(tmp_path / "scene")
    sequence = ImageSequence(data, SequenceOptions(start_s=0.4, duration_s=0.6), rate_hz=10.0)
    frames, expected = list(sequence), list(posed_frames(data))[4:]
    assert [frame.time_ns for frame in frames] == pytest.approx([i * 1e8 for i in range(4, 10)])
    assert all(same(f.world_from_camera, e.world_from_camera, 1e-12) for f, e in zip(frames, expected, strict=True))
    assert not sequence.has_stamps
    assert any("10 images a second are assumed" in notice for notice in sequence.notices)
    stamped = ImageSequence(make_tum(tmp_path / "desk"), rate_hz=10.0)
    assert stamped.has_stamps
    assert np.diff([frame.time_ns for frame in stamped]).tolist() == pytest.approx([STEP_NS] * 9, abs=1000)


def test_several_sequences_of_a_data_set_are_not_one(tmp_path):
    scene = make_7scenes(tmp_path / "scene", num_images=2, sequences=("seq-01", "seq-02"))
    with pytest.raises(SequenceError, match="scene: 2 sequences, expected one at a time"):
        ImageSequence(scene)
    (scene / "TestSplit.txt").write_text("sequence2\n")
    assert len(list(ImageSequence(scene / "TestSplit.txt"))) == 2


def test_a_part_is_taken_by_the_numbers_of_the_images(clip, tmp_path):
    assert stamps_ms(ImageSequence(clip, frames=slice(2, 5))) == TIMES_MS[2:5]
    data = make_7scenes(tmp_path / "scene")
    sequence = ImageSequence(data, frames=slice(3, 7))
    for frame, other in zip(sequence, posed_frames(data, frames=slice(3, 7)), strict=True):
        assert frame.time_ns == other.time_ns
        assert same(frame.world_from_camera, other.world_from_camera, 1e-12)
    assert sequence.counts.are_complete
    assert (sequence.counts.stated, sequence.counts.used, sequence.counts.skipped) == (4, 4, {})
    assert sequence.num_images == 4
    assert not any("were asked for" in notice for notice in sequence.notices)
    beyond = ImageSequence(data, frames=slice(8, 900))
    assert len(list(beyond)) == 2
    assert "images 8:900 were asked for, and there are 10, numbered 0 to 9: 8 to 9 were taken" in beyond.notices
    whole = "in frames 10:20; there are 10, numbered 0 to 9$"
    with pytest.raises(SequenceError, match=f"scene: no image with a true pose {whole}"):
        list(ImageSequence(data, frames=slice(10, 20)))
    with pytest.raises(SequenceError, match=r"images: no image in frames 2:; there are 2, numbered 0 to 1$"):
        list(ImageSequence(folder_of(tmp_path / "images", ["1", "2"]), frames=slice(2, None)))
    last = ImageSequence(data, frames=slice(9, 11))
    assert len(list(last)) == 1
    assert "images 9:11 were asked for, and there are 10, numbered 0 to 9: 9 was taken" in last.notices
