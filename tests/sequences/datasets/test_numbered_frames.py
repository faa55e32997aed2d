"""Numbered frames (Ambiguous Relocalization, Ceiling): images, poses, order, and what is wrong with them."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from sequences.datasets.convert import convert
from sequences.datasets.frames import posed_frames
from sequences.datasets.listing import list_images
from sequences.errors import SequenceError
from sequences.files import UNUSABLE
from tests.helpers.data_sets import (
    INTRINSICS,
    THIRTIETH_NS,
    check,
    make_7scenes,
    make_ambiguous,
    make_ceiling,
    write_image,
)
from tests.helpers.dot_scene import leaves_out


@pytest.fixture(
    params=[
        (make_ambiguous, "seq00/poses_seq00.txt", "rgb_matched/frame-color-0004.png"),
        (make_ceiling, "0/poses.txt", "images/000004.jpg"),
    ]
)
def numbered(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Path, Path]:
    """The file of poses of a sequence, and its image of frame 4."""
    make, poses, image = request.param
    file = make(tmp_path / "scene") / "train" / poses
    return file, file.parent / image


def test_numbered_frames_of_a_sequence_or_a_split(numbered: tuple[Path, Path]) -> None:
    sequence = numbered[0].parent
    scene = sequence.parent.parent
    first = [3 * THIRTIETH_NS, 4 * THIRTIETH_NS, 17 * THIRTIETH_NS]
    check(sequence, [0, 1, 2], first)
    check(scene / "train", [0, 1, 2, 3, 4], [*first, first[-1] + 1e9, first[-1] + 1e9 + THIRTIETH_NS])
    check(scene / "test", [5], [0])
    assert list_images(scene / "test").layout == {"poses.txt": "Ceiling"}.get(
        numbered[0].name, "Ambiguous Relocalization"
    )
    assert list_images(scene / "test").assumed_hz == 30
    with pytest.raises(SequenceError, match=r"perhaps its train or test is meant"):
        list_images(scene)


def test_numbered_frames_without_an_image_or_a_usable_pose_are_counted(numbered: tuple[Path, Path]) -> None:
    poses, image = numbered
    sequence = poses.parent
    rows = poses.read_text().splitlines()  # of frames 17, 4 and 3
    separator = ", " if "," in rows[0] else " "
    poses.write_text("\n".join(["# a comment", "", rows[0]]))
    check(sequence, [2])
    assert list_images(sequence).skipped == {"no true pose": 2}
    fields = rows[1].split(separator)
    fields[4] = "nan"
    poses.write_text("\n".join([separator.join(fields), rows[0], rows[2]]))
    image.with_name(image.name.replace("04", "17")).unlink()
    check(sequence, [0])
    assert list_images(sequence).skipped == {"no image": 1, "true pose not finite": 1}
    poses.write_text(separator.join(fields))
    with pytest.raises(SequenceError, match=r"no image with a true pose: .*'true pose not finite': 1"):
        list_images(sequence)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda fields: [fields[0], "17", *fields[2:]], "frame 17 is on line 1 too, expected it once"),
        (lambda fields: ["6", *fields[1:]], "sequence 6 after sequence 0, expected one a file"),
    ],
)
def test_rows_of_numbered_frames_that_contradict_each_other_are_refused(
    numbered: tuple[Path, Path], change: Callable[[list[str]], list[str]], said: str
) -> None:
    poses = numbered[0]
    sequence = poses.parent
    change_row(poses, change)
    with pytest.raises(SequenceError) as error:
        list_images(sequence)
    assert str(error.value).startswith(f"{poses}:2: {said}")


def change_row(file: Path, change: Callable[[list[str]], list[str]]) -> None:
    """Change the second row, of frame 4."""
    rows = file.read_text().splitlines()
    separator = ", " if "," in rows[1] else " "
    rows[1] = separator.join(change(rows[1].split(separator)))
    file.write_text("\n".join(rows))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda fields: fields[:-1], "8 columns, expected the 9 of `seq "),
        (lambda fields: [*fields, "1"], "10 columns, expected the 9 of `seq "),
        (lambda fields: [*fields[:2], "x", *fields[3:]], "'x' is no number, expected those"),
        (lambda fields: [*fields[:2], *["0"] * 7], "quaternion of length 0, expected a unit quaternion"),
        (lambda fields: [*fields[:2], *["3"] * 7], "quaternion of length 6, expected a unit quaternion"),
        (lambda fields: [fields[0], "4.5", *fields[2:]], "number of a frame: '4.5', expected a whole number"),
        (lambda fields: [], "columns, expected the numbers of a sequence and a frame first"),
    ],
)
def test_a_row_of_numbered_frames_that_cannot_be_used_is_left_out_and_named(
    numbered: tuple[Path, Path], change: Callable[[list[str]], list[str]], said: str
) -> None:
    poses = numbered[0]
    sequence = poses.parent
    change_row(poses, lambda fields: change(fields) or ["none"])
    listed = leaves_out(sequence, 3, f"{poses}:2: ", said)
    assert listed.skipped[UNUSABLE] == 1
    check(sequence, [0, 2])
    rows = poses.read_text().splitlines()
    poses.write_text(rows[1])
    with pytest.raises(SequenceError, match=r":1: .*; 1 of 1 rows cannot be used, expected at most one in two"):
        list_images(sequence)


def test_images_that_are_not_one_a_frame_are_refused(numbered: tuple[Path, Path]) -> None:
    poses, image = numbered
    sequence = poses.parent
    twin = image.with_name("twin-4.png")
    write_image(twin, 9)
    with pytest.raises(SequenceError, match=r"frame 4 is .* too, expected one image a frame"):
        list_images(sequence)
    for file in twin.parent.iterdir():
        file.unlink()
    with pytest.raises(SequenceError, match="no images, expected PNG or JPEG files with a frame number in"):
        list_images(sequence)


def test_intrinsics_are_unknown_until_somebody_states_them_and_then_a_conversion_has_them(tmp_path: Path) -> None:
    train = make_ambiguous(tmp_path / "data" / "scene") / "train"
    assert next(posed_frames(train)).camera is None
    with pytest.raises(SequenceError, match=r"does not state intrinsics, expected intrinsics\.json"):
        convert(train, tmp_path / "out.mcap")
    for wrong in ({"fx": np.nan}, {"fy": -300.0}):
        (tmp_path / "data" / "intrinsics.json").write_text(json.dumps(INTRINSICS | wrong))
        with pytest.raises(SequenceError, match=r"intrinsics\.json: "):
            convert(train, tmp_path / "out.mcap")
        assert [file.name for file in tmp_path.iterdir()] == ["data"]
    (tmp_path / "data" / "intrinsics.json").write_text(json.dumps(INTRINSICS))
    camera = next(posed_frames(train)).camera
    assert camera is not None
    assert (camera.width, camera.fx, camera.fy, camera.cx) == (32, 29.25, 28.5, 15.5)
    assert convert(train, tmp_path / "out.mcap").num_images == 5
    assert [frame.time_ns for frame in posed_frames(tmp_path / "out.mcap")] == [
        frame.time_ns for frame in posed_frames(train)
    ]


def test_distortion_that_intrinsics_state_is_taken_out_of_the_images(tmp_path: Path) -> None:
    train = make_ambiguous(tmp_path / "data" / "scene") / "train"
    stated = tmp_path / "data" / "intrinsics.json"
    stated.write_text(json.dumps(INTRINSICS))
    plain = next(posed_frames(train))
    for more in ({"distortion": [0.3, 0, 0, 0]}, {"distortion": [0.1] * 4, "distortion_model": "equidistant"}):
        stated.write_text(json.dumps(INTRINSICS | more))
        frame = next(posed_frames(train))
        assert frame.camera.width == plain.camera.width
        assert frame.camera != plain.camera  # that of the undistorted image
        np.testing.assert_array_equal(frame.world_from_camera.as_matrix(), plain.world_from_camera.as_matrix())
    stated.write_text(json.dumps(INTRINSICS | {"distortion": [0, 0, 0, 0]}))
    assert next(posed_frames(train)).camera == plain.camera
    for more, said in (
        ({"distortion": 0.3}, r"distortion is 0\.3, expected a list"),
        ({"distortion": ["k"] * 4}, "distortion"),
        ({"distortion": [0.3]}, "1 distortion coefficients of plumb_bob, expected 4"),
        ({"distortion": [0.3] * 4, "distortion_model": "barrel"}, "distortion model 'barrel', expected one of"),
    ):
        stated.write_text(json.dumps(INTRINSICS | more))
        with pytest.raises(SequenceError, match=rf"intrinsics\.json: {said}"):
            next(posed_frames(train))


def test_images_of_a_sequence_that_lost_its_poses_are_counted(tmp_path: Path) -> None:
    for make, poses in ((make_ambiguous, "seq10/poses_seq10.txt"), (make_ceiling, "10/poses.txt")):
        split = make(tmp_path / make.__name__) / "train"
        (split / poses).unlink()
        (split / "notes").mkdir()
        check(split, [0, 1, 2])
        assert list_images(split).skipped == {"no true pose": 2}
    scene = make_7scenes(tmp_path / "chess", num_images=2, sequences=("seq-01", "seq-02"))
    for pose in (scene / "seq-02").glob("*.pose.txt"):
        pose.unlink()
    assert list_images(scene).skipped == {"no true pose": 2}


def test_two_files_of_poses_in_one_sequence_are_refused(tmp_path: Path) -> None:
    train = make_ambiguous(tmp_path / "scene") / "train"
    (train / "seq10" / "poses_seq00.txt").write_text("")
    with pytest.raises(SequenceError, match=r"poses_seq00\.txt and poses_seq10\.txt, expected one file of poses"):
        list_images(train)
