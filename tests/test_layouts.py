"""Layouts of data sets, each as a small copy from known poses -> images, poses, order, and what is wrong with them."""

import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from filtering.se3 import Poses
from sequences.datasets import layouts
from sequences.datasets.convert import convert
from sequences.datasets.frames import count_frames, posed_frames
from sequences.datasets.listing import files_read, find_layouts, is_recording, list_images
from sequences.errors import SequenceError
from sequences.frame import Camera
from sequences.images.decoding import decode_image_bytes
from sequences.images.undistortion import Lens, pinhole_of, undistorted
from sequences.options import SequenceOptions
from sequences.reader import SequenceReader
from tests.data_sets import (
    COLMAP_NAMES,
    HEADER,
    INTRINSICS,
    cambridge_row,
    colmap_row,
    make_7scenes,
    make_ambiguous,
    make_cambridge,
    make_ceiling,
    make_colmap,
    make_tum,
    same,
    true_pose,
    write_image,
    write_images,
)

THIRTIETH_NS = 1_000_000_000 / 30


def check(path: Path, indices: list[int], times_ns: list[float] | None = None) -> None:
    """What is seen in the frames, their poses and their stamps."""
    frames = list(posed_frames(path))
    assert [int(frame.image[0, 0, 0]) // 10 for frame in frames] == indices
    assert count_frames(path) == len(indices)
    for index, frame in zip(indices, frames, strict=True):
        assert same(frame.world_from_camera, true_pose(index), 1e-6)
    if times_ns is not None:
        np.testing.assert_allclose([frame.time_ns for frame in frames], times_ns, atol=1)


# --- sequences with numbered frames ----------------------------------------------------------------


NUMBERED = pytest.mark.parametrize(
    ("make", "folder", "poses", "image"),
    [
        (make_ambiguous, "seq00", "poses_seq00.txt", "rgb_matched/frame-color-0004.png"),
        (make_ceiling, "0", "poses.txt", "images/000004.jpg"),
    ],
)


@NUMBERED
def test_numbered_frames_of_a_sequence_or_a_split(
    make: Callable[[Path], Path], folder: str, poses: str, image: str, tmp_path: Path
) -> None:
    scene = make(tmp_path / "scene")
    first = [3 * THIRTIETH_NS, 4 * THIRTIETH_NS, 17 * THIRTIETH_NS]
    check(scene / "train" / folder, [0, 1, 2], first)
    check(scene / "train", [0, 1, 2, 3, 4], [*first, first[-1] + 1e9, first[-1] + 1e9 + THIRTIETH_NS])
    check(scene / "test", [5], [0])
    assert list_images(scene / "test").layout == {"poses.txt": "Ceiling"}.get(poses, "Ambiguous Relocalization")
    assert list_images(scene / "test").assumed_hz == 30
    with pytest.raises(SequenceError, match=r"perhaps its train or test is meant"):
        list_images(scene)


@NUMBERED
def test_numbered_frames_without_an_image_or_a_usable_pose_are_counted(
    make: Callable[[Path], Path], folder: str, poses: str, image: str, tmp_path: Path
) -> None:
    sequence = make(tmp_path / "scene") / "train" / folder
    rows = (sequence / poses).read_text().splitlines()  # of frames 17, 4 and 3
    separator = ", " if "," in rows[0] else " "
    (sequence / poses).write_text("\n".join(["# a comment", "", rows[0]]))
    check(sequence, [2])
    assert list_images(sequence).skipped == {"no true pose": 2}
    fields = rows[1].split(separator)
    fields[4] = "nan"
    (sequence / poses).write_text("\n".join([separator.join(fields), rows[0], rows[2]]))
    (sequence / image.replace("04", "17")).unlink()
    check(sequence, [0])
    assert list_images(sequence).skipped == {"no image": 1, "true pose not finite": 1}
    (sequence / poses).write_text(separator.join(fields))
    with pytest.raises(SequenceError, match=r"no image with a true pose: .*'true pose not finite': 1"):
        list_images(sequence)


@NUMBERED
@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda fields: fields[:-1], "8 columns, expected the 9 of `seq "),
        (lambda fields: [*fields, "1"], "10 columns, expected the 9 of `seq "),
        (lambda fields: [*fields[:2], "x", *fields[3:]], "'x' is no number, expected those"),
        (lambda fields: [*fields[:2], *["0"] * 7], "quaternion of length 0, expected a unit quaternion"),
        (lambda fields: [*fields[:2], *["3"] * 7], "quaternion of length 6, expected a unit quaternion"),
        (lambda fields: [fields[0], "4.5", *fields[2:]], "number of a frame: '4.5', expected a whole number"),
        (lambda fields: [fields[0], "17", *fields[2:]], "frame 17 is on line 1 too, expected it once"),
        (lambda fields: ["6", *fields[1:]], "sequence 6 after sequence 0, expected one a file"),
    ],
)
def test_a_row_of_numbered_frames_that_is_wrong_is_named(
    make: Callable[[Path], Path],
    folder: str,
    poses: str,
    image: str,
    change: Callable[[list[str]], list[str]],
    said: str,
    tmp_path: Path,
) -> None:
    sequence = make(tmp_path / "scene") / "train" / folder
    rows = (sequence / poses).read_text().splitlines()
    separator = ", " if "," in rows[1] else " "
    rows[1] = separator.join(change(rows[1].split(separator)))
    (sequence / poses).write_text("\n".join(rows))
    with pytest.raises(SequenceError) as error:
        list_images(sequence)
    assert str(error.value).startswith(f"{sequence / poses}:2: {said}")


@NUMBERED
def test_images_that_are_not_one_a_frame_are_refused(
    make: Callable[[Path], Path], folder: str, poses: str, image: str, tmp_path: Path
) -> None:
    sequence = make(tmp_path / "scene") / "train" / folder
    twin = (sequence / image).with_name("twin-4.png")
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


# --- 7-Scenes by split -----------------------------------------------------------------------------


def test_a_7_scenes_split_gives_its_sequences_in_its_order(tmp_path: Path) -> None:
    scene = make_7scenes(tmp_path / "scene", num_images=2, sequences=("seq-01", "seq-02", "seq-03"))
    (scene / "TrainSplit.txt").write_text("sequence3\r\nsequence1\r\n")
    (scene / "TestSplit.txt").write_text("# one of three\nsequence2")
    names = [str(file.relative_to(scene)) for file in list_images(scene / "TrainSplit.txt").files]
    assert names == [f"seq-0{s}/frame-00000{i}.color.png" for s in (3, 1) for i in (0, 1)]
    assert [file.parent.name for file in list_images(scene / "TestSplit.txt").files] == ["seq-02"] * 2
    assert len(list(posed_frames(scene / "TrainSplit.txt", frames=slice(1, None)))) == 3
    assert count_frames(scene) == 6


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("sequence1\nsequence7\n", r":2: sequence7, expected frame-\*\.pose\.txt in .*seq-07"),
        ("sequence1\nsequence01\n", ":2: sequence01 for the second time"),
        ("seq one\n", ":1: 'seq one', expected the name of a sequence, such as sequence1"),
        ("\n", ": names no sequence"),
    ],
)
def test_a_7_scenes_split_that_is_wrong_is_named(content: str, said: str, tmp_path: Path) -> None:
    scene = make_7scenes(tmp_path / "scene", num_images=2)
    (scene / "TestSplit.txt").write_text(content)
    with pytest.raises(SequenceError, match=rf"TestSplit\.txt{said}"):
        list_images(scene / "TestSplit.txt")


def test_7_scenes_poses_and_images_without_each_other_are_counted(tmp_path: Path) -> None:
    folder = make_7scenes(tmp_path / "scene", num_images=5) / "seq-01"
    (folder / "frame-000001.color.png").unlink()
    (folder / "frame-000002.pose.txt").unlink()
    (folder / "frame-000003.pose.txt").write_text("inf 0 0 0\n" * 4)
    images = list_images(folder)
    assert [file.name[:12] for file in images.files] == ["frame-000000", "frame-000004"]
    assert images.skipped == {"no image": 1, "no true pose": 1, "true pose not finite": 1}


@pytest.mark.parametrize(
    ("matrix", "said"),
    [
        (np.diag([1.0, 1, -1, 1]), "no rotation"),
        (np.diag([1.02, 1.02, 1.02, 1]), "no rotation"),
        (np.eye(4) + np.outer([0, 0, 0, 1.0], [2, 3, 4, 0]), r"last row \[2\.0, 3\.0, 4\.0, 1\.0\], expected 0 0 0 1"),
    ],
)
def test_a_7_scenes_pose_left_handed_stretched_or_transposed_is_refused(
    matrix: np.ndarray, said: str, tmp_path: Path
) -> None:
    scene = make_7scenes(tmp_path / "scene", num_images=2)
    np.savetxt(scene / "seq-01" / "frame-000001.pose.txt", matrix)
    with pytest.raises(SequenceError, match=rf"frame-000001\.pose\.txt: .*{said}"):
        list_images(scene)


# --- Cambridge Landmarks ---------------------------------------------------------------------------


def test_a_cambridge_list_gives_its_images_by_sequence_and_frame(tmp_path: Path) -> None:
    scene = make_cambridge(tmp_path / "scene")
    expected_ns = [0, THIRTIETH_NS, THIRTIETH_NS + 1e9, 2 * THIRTIETH_NS + 1e9]
    check(scene / "dataset_train.txt", [0, 1, 2, 3], expected_ns)
    check(scene / "dataset_test.txt", [4], [0])
    images = list_images(scene / "dataset_train.txt")
    assert (images.layout, images.skipped, images.cameras) == ("Cambridge Landmarks", {}, [None] * 4)
    (scene / "intrinsics.json").write_text(json.dumps(INTRINSICS))
    assert [camera.fx if camera else None for camera in list_images(scene / "dataset_train.txt").cameras] == [29.25] * 4
    with pytest.raises(SequenceError, match=r"perhaps its dataset_train\.txt or dataset_test\.txt is meant"):
        list_images(scene)


def test_a_published_cambridge_pose_looks_at_the_shop_and_stands_upright(tmp_path: Path) -> None:
    """Shop Façade, where the shop is at larger y and z is up; read the other way round, it would look away from it."""
    write_images(tmp_path, {0: "seq1/frame00001.png"})
    row = "seq1/frame00001.png -0.157816 -10.413150 1.832074 0.712261 0.682691 -0.123193 0.106962\n"
    (tmp_path / "dataset_test.txt").write_text(HEADER + row)
    pose = list_images(tmp_path / "dataset_test.txt").world_from_camera[0]
    np.testing.assert_allclose(pose.translation, [-0.157816, -10.413150, 1.832074])
    right, down, ahead = pose.rotation.T
    assert ahead[1] > 0.9
    assert down[2] < -0.9
    assert right[0] > 0.9


def test_what_a_cambridge_list_leaves_out_is_counted(tmp_path: Path) -> None:
    scene = make_cambridge(tmp_path / "scene")
    rows = [
        cambridge_row("seq2/frame00009.png", Poses(np.eye(3), np.array([3.1e9, -1.4e8, -1.2e9]))),
        cambridge_row("seq2/frame00010.png", true_pose(1)),
        "seq10/frame00001.png nan 0 0 1 0 0 0",
        cambridge_row("seq10/frame00007.png", true_pose(7)),
    ]
    (scene / "dataset_train.txt").write_text(HEADER + "\n".join(rows))
    check(scene / "dataset_train.txt", [1])
    assert list_images(scene / "dataset_train.txt").skipped == {
        "true pose more than 10 km away": 1,
        "true pose not finite": 1,
        "no image": 1,
        "image not in the list": 1,  # seq10/frame00002.png; those of seq1 are another split's
    }
    (scene / "dataset_train.txt").write_text(HEADER + cambridge_row("seq2/frame00010.png", true_pose(1)))
    assert list_images(scene / "dataset_train.txt").skipped == {"image not in the list": 3}  # of seq10 two


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (HEADER + "seq2/frame00009.png 1 2 3 1 0 0\n", "4: 7 columns, expected the 8 of `file tx ty tz qw qx qy qz`"),
        (HEADER + "seq2/frame00009.png 1 2 3 1 0 0 a\n", "4: 'a' is no number"),
        (HEADER + "seq2/frame00009.png 1 2 3 0 0 0 0\n", "4: quaternion of length 0, expected a unit quaternion"),
        (HEADER + "seq2/frame00009.png 1 2 3 1 0 0 0\n" * 2, "5: 'seq2/frame00009.png' is on line 4 too"),
        ("seq2/frame00009.png 1 2 3 1 0 0 0\n" * 5, "1: .* among the first three lines, expected them to be a header"),
    ],
)
def test_a_cambridge_list_that_is_wrong_is_named(content: str, said: str, tmp_path: Path) -> None:
    scene = make_cambridge(tmp_path / "scene")
    (scene / "dataset_train.txt").write_text(content)
    with pytest.raises(SequenceError, match=rf"dataset_train\.txt:{said}"):
        list_images(scene / "dataset_train.txt")


# --- COLMAP ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("model", "images", "path"),
    [
        ("sparse/0", "images", "."),
        ("sparse", "images", "."),
        ("sparse/0", "images", "sparse/0"),
        ("model", "images", "model"),
        ("model", "model", "model"),
        ("model", ".", "model"),
        ("model", "model/images", "model"),
    ],
)
def test_a_colmap_model_gives_images_wherever_they_lie(model: str, images: str, path: str, tmp_path: Path) -> None:
    root = make_colmap(tmp_path / "scene", model, images)
    check(root / path, [0, 1, 2], [0, THIRTIETH_NS, THIRTIETH_NS + 1e9])
    listed = list_images(root / path)
    assert (listed.layout, listed.skipped) == ("COLMAP", {})


def test_colmap_cameras_are_each_image_s_own_at_its_size(tmp_path: Path) -> None:
    root = make_colmap(tmp_path / "scene", "sparse/0", "images")
    found = [(c.width, c.height, c.fx, c.fy, c.cx, c.cy) for f in posed_frames(root) if (c := f.camera)]
    # Camera 1 at half its size; the middle of COLMAP's image, 16 and 12, is between the pixels 15 and 16, 11 and 12.
    assert found == [(32, 24, 30, 29, 15.5, 11.5)] * 2 + [(32, 24, 30, 30, 15.5, 11.5)]
    with pytest.raises(SequenceError, match="images of 2 cameras, expected one"):
        convert(root, tmp_path / "out.mcap")


@pytest.mark.parametrize(
    ("parameters", "focal", "distortion"),
    [
        ("SIMPLE_PINHOLE 32 24 30 16 12", (30.0, 30.0), None),
        ("PINHOLE 32 24 30 29 16 12", (30.0, 29.0), None),
        ("SIMPLE_RADIAL 32 24 30 16 12 0", (30.0, 30.0), None),
        ("SIMPLE_RADIAL 32 24 30 16 12 0.1", (30.0, 30.0), ("plumb_bob", 0.1, 0, 0, 0)),
        ("RADIAL 32 24 30 16 12 0.1 0.2", (30.0, 30.0), ("plumb_bob", 0.1, 0.2, 0, 0)),
        ("OPENCV 32 24 30 29 16 12 0.1 0.2 0.03 0.04", (30.0, 29.0), ("plumb_bob", 0.1, 0.2, 0.03, 0.04)),
        (
            "FULL_OPENCV 32 24 30 29 16 12 0.1 0.2 0.03 0.04 0.05 0.06 0.07 0.08",
            (30.0, 29.0),
            ("rational_polynomial", 0.1, 0.2, 0.03, 0.04, 0.05, 0.06, 0.07, 0.08),
        ),
        ("SIMPLE_RADIAL_FISHEYE 32 24 30 16 12 0", (30.0, 30.0), ("equidistant", 0, 0, 0, 0)),
        ("RADIAL_FISHEYE 32 24 30 16 12 0.1 0.2", (30.0, 30.0), ("equidistant", 0.1, 0.2, 0, 0)),
        ("OPENCV_FISHEYE 32 24 30 29 16 12 0.1 0.2 0.3 0.4", (30.0, 29.0), ("equidistant", 0.1, 0.2, 0.3, 0.4)),
    ],
)
def test_colmap_camera_models(
    parameters: str, focal: tuple[float, float], distortion: tuple | None, tmp_path: Path
) -> None:
    root = make_colmap(tmp_path / "scene", "sparse/0", "images")
    (root / "sparse" / "0" / "cameras.txt").write_text(f"1 {parameters}\n2 {parameters}\n")
    stated = Camera(32, 24, *focal, 15.5, 11.5)
    lens = Lens(stated, distortion[0], tuple(map(float, distortion[1:]))) if distortion else stated
    assert list_images(root).cameras == [lens] * 3
    shown = decode_image_bytes((root / "images" / COLMAP_NAMES[0]).read_bytes())
    frame = next(posed_frames(root))
    assert frame.camera == pinhole_of(lens)
    np.testing.assert_array_equal(frame.image, undistorted(shown, lens)[0])
    as_it_is = next(posed_frames(root, options=SequenceOptions(undistort=False)))
    assert as_it_is.camera == stated
    np.testing.assert_array_equal(as_it_is.image, shown)
    # Images are copied with their distortion, which is undone in reading.
    assert convert(root, tmp_path / "out.mcap").num_images == 3
    reader = SequenceReader(tmp_path / "out.mcap", odometry="unread")
    assert reader.camera is not None
    assert frame.camera is not None
    assert reader.camera.fx == pytest.approx(frame.camera.fx, rel=1e-6)
    np.testing.assert_array_equal(next(iter(reader)).image, frame.image)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("1 FOV 32 24 30 29 16 12 0.9", "camera model 'FOV', expected one of SIMPLE_PINHOLE.*image_undistorter"),
        ("1 PINHOLE 32 24 30 16 12", "3 parameters, expected the 4 of PINHOLE"),
        ("1 PINHOLE 32", "3 columns, expected `CAMERA_ID MODEL WIDTH HEIGHT PARAMS"),
        ("1 PINHOLE 32 24 30 x 16 12", "'x' is no number"),
        ("1 PINHOLE 32 24 30 nan 16 12", "fy is nan, expected a number"),
        ("1 PINHOLE 32 24 30 0 16 12", "camera with fy 0.0, expected between"),
        ("2 PINHOLE 32 24 30 29 16 12", "camera '2' for the second time"),
    ],
)
def test_a_colmap_camera_that_is_wrong_is_named(line: str, said: str, tmp_path: Path) -> None:
    root = make_colmap(tmp_path / "scene", "sparse/0", "images")
    (root / "sparse" / "0" / "cameras.txt").write_text(f"# cameras\n2 SIMPLE_PINHOLE 32 24 30 16 12\n{line}\n")
    with pytest.raises(SequenceError, match=rf"cameras\.txt:3: .*{said}"):
        list_images(root)


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        (["1 1 0 0 0 0 0 0 1"], "1: 9 columns, expected the 10 of `id qw"),
        (["1 1 0 0 0 0 0 y 1 a/frame9.png", ""], "1: 'y' is no number"),
        (["1 0 0 0 0 0 0 0 1 a/frame9.png", ""], "1: quaternion of length 0"),
        (["1 1 0 0 0 0 0 0 7 a/frame9.png", ""], r"1: camera '7', expected one of those in cameras\.txt"),
        (
            ["1 1 0 0 0 0 0 0 1 a/frame9.png", "", "2 1 0 0 0 0 0 0 1 a/frame9.png"],
            "3: 'a/frame9.png' is on line 1 too",
        ),
        (["1 1 0 0 0 0 0 0 1 a/frame9.png", "2 1 0 0 0 0 0 0 1 x.png"], "2: 10 columns, expected keypoints of 'a/fr"),
        (["1 1 0 0 0 0 0 0 1 nowhere.png"], r" none of its images found, looked in .*scene/images,"),
    ],
)
def test_a_colmap_image_that_is_wrong_is_named(rows: list[str], said: str, tmp_path: Path) -> None:
    root = make_colmap(tmp_path / "scene", "sparse/0", "images")
    (root / "sparse" / "0" / "images.txt").write_text("\n".join(rows))
    with pytest.raises(SequenceError, match=rf"images\.txt:{said}"):
        list_images(root)


def test_what_a_colmap_model_leaves_out_is_counted(tmp_path: Path) -> None:
    root = make_colmap(tmp_path / "scene", "sparse/0", "images")
    rows = [
        "1 nan 0 0 0 0 0 0 1 a/frame9.png",
        "",
        colmap_row(2, true_pose(1), 1, "a/frame10.png"),
        "",
        "3 1 0 0 0 0 0 0 2 gone.png",
    ]
    (root / "sparse" / "0" / "images.txt").write_text("\n".join(rows))
    write_images(root / "images", {7: "a/frame11.png"})
    check(root, [1])
    counted = {"true pose not finite": 1, "no image": 1, "image not in the list": 2}  # one in a folder of its own
    assert list_images(root).skipped == counted


# --- all of them -----------------------------------------------------------------------------------


def test_a_folder_or_file_of_no_layout_is_told_what_was_looked_for(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("none")
    with pytest.raises(SequenceError, match="is a file, expected the folder of a data set or the list of a split"):
        list(posed_frames(tmp_path / "notes.txt"))
    with pytest.raises(SequenceError, match="no sequence or data set; looked for") as error:
        list(posed_frames(tmp_path))
    for file in (
        *("metadata.yaml", "groundtruth.txt", "frame-*.pose.txt", "poses_seq*.txt", "poses.txt"),
        *("dataset_train.txt", "images.bin"),
    ):
        assert file in str(error.value)


def test_stamped_data_says_that_its_stamps_are_not_assumed(tmp_path: Path) -> None:
    images = list_images(make_tum(tmp_path / "tum"))
    assert (images.layout, images.assumed_hz, len(images.cameras)) == ("TUM RGB-D", None, 10)
    some = images[2:8:3]
    assert [file.name for file in some.files] == [images.files[2].name, images.files[5].name]
    assert same(some.world_from_camera, images.world_from_camera[[2, 5]], 1e-12)


def test_layouts_are_asked_in_an_order_that_each_of_them_states() -> None:
    found = find_layouts()
    assert [layout.name for layout in found] == [
        *("TUM RGB-D", "EuRoC MAV", "7-Scenes", "Ambiguous Relocalization", "Ceiling", "Cambridge Landmarks"),
        *("Stray Scanner", "Record3D", "nerfstudio", "COLMAP"),
    ]
    assert len({layout.order for layout in found}) == len(found)


NEW_LAYOUT = """
import numpy as np
from filtering.se3 import Poses
from sequences.datasets.layout import Layout
from sequences.datasets.posed_images import PosedImages


def list_images(path):
    if not (path / "phone.txt").is_file():
        return None
    return PosedImages("Phone", [path / "0.png"], np.array([7]), Poses.identity(1), [None])


LAYOUT = Layout("Phone", looked_for="phone.txt", order=85, list_images=list_images, list_suffixes=(".phone",))
"""


@pytest.fixture
def new_layout(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[None]:
    """One more file among the layouts."""
    (tmp_path / "more").mkdir()
    (tmp_path / "more" / "phone.py").write_text(NEW_LAYOUT)
    monkeypatch.setattr(layouts, "__path__", [*layouts.__path__, str(tmp_path / "more")])
    find_layouts.cache_clear()
    yield
    find_layouts.cache_clear()


@pytest.mark.usefixtures("new_layout")
def test_a_new_layout_is_one_new_file(tmp_path: Path) -> None:
    scan = tmp_path / "scan"
    scan.mkdir()
    write_image(scan / "0.png", 0)
    with pytest.raises(SequenceError, match=r"odometry\.csv, \.r3d, phone\.txt, transforms\.json, images\.bin$"):
        list_images(scan)
    (scan / "phone.txt").write_text("")
    (frame,) = posed_frames(scan)
    assert (frame.time_ns, frame.image.shape) == (7, (24, 32, 3))
    (scan / "list.phone").write_text("")
    assert not is_recording(scan / "list.phone")
    assert scan in files_read(scan / "list.phone")


def test_layouts_are_not_imported_before_a_data_set_is_read() -> None:
    imported = "[name for name in sys.modules if name.startswith('sequences.datasets.layouts.')]"
    program = f"import sys; from sequences.datasets import frames; assert not {imported}"
    subprocess.run([sys.executable, "-c", program], check=True)
