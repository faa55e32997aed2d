"""Small data sets of several layouts on disk, made from known poses."""

from pathlib import Path

import cv2
import numpy as np

from filtering.se3 import Poses
from sequences.datasets.frames import posed_frames
from sequences.frame import Trajectory
from sequences.trajectories.tum import format_time, write_tum
from tests.helpers.sequence_files import BEGIN_NS, world_from_camera

STEP_NS = 33_333_333


def write_image(path: Path, index: int, width: int = 32, height: int = 24) -> None:
    image = np.full((height, width, 3), (10 * index + 5) % 256, np.uint8)
    cv2.imwrite(str(path), image)


def truth_at(times_ns: list[int]) -> Trajectory:
    return Trajectory(np.array(times_ns), Poses.stack([world_from_camera(t) for t in times_ns]))


def make_tum(folder: Path, *, num_images: int = 10) -> Path:
    """A TUM RGB-D folder: true poses at 100 Hz, off the images' stamps."""
    folder.mkdir()
    (folder / "rgb").mkdir()
    lines = ["# color images", "# timestamp filename"]
    for i in range(num_images):
        time = format_time(BEGIN_NS + i * STEP_NS)
        write_image(folder / "rgb" / f"{time}.png", i)
        lines.append(f"{time} rgb/{time}.png")
    (folder / "rgb.txt").write_text("\n".join(lines) + "\n")
    write_tum(folder / "groundtruth.txt", truth_at([BEGIN_NS - 3_000_000 + 10_000_000 * i for i in range(40)]))
    return folder


def make_7scenes(folder: Path, *, num_images: int = 10, sequences: tuple[str, ...] = ("seq-01",)) -> Path:
    """A 7-Scenes scene: 30 Hz from the first frame's number on, without stamps."""
    for sequence in sequences:
        (folder / sequence).mkdir(parents=True)
        for i in range(num_images):
            write_image(folder / sequence / f"frame-{i:06d}.color.png", i)
            matrix = world_from_camera(BEGIN_NS + i * STEP_NS).as_matrix()
            np.savetxt(folder / sequence / f"frame-{i:06d}.pose.txt", matrix)
    return folder


def same(a: Poses | None, b: Poses, tolerance: float) -> bool:
    return a is not None and bool(np.abs(a.as_matrix() - b.as_matrix()).max() < tolerance)


INTRINSICS = {"width": 64, "height": 48, "fx": 58.5, "fy": 57.0, "cx": 31.5, "cy": 23.5}


def true_pose(index: int) -> Poses:
    """World from camera, far from any symmetry that would forgive a wrong convention."""
    return Poses.exp(np.array([3.0 + index, -2.0, 1.0 + 0.5 * index, 0.3, 1.1 - 0.2 * index, -0.7]))


def numbers(translation: np.ndarray, quat_xyzw: np.ndarray, order: str) -> list[str]:
    """Values by the names of an order such as `qw qx qy qz tx ty tz`."""
    values = dict(zip(("tx", "ty", "tz", "qx", "qy", "qz", "qw"), (*translation, *quat_xyzw), strict=True))
    return [f"{values[name]:.9f}" for name in order.split()]


def pose_numbers(pose: Poses, order: str) -> list[str]:
    return numbers(pose.translation, pose.as_quat_xyzw(), order)


def write_images(folder: Path, names: dict[int, str]) -> None:
    for index, name in names.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        write_image(folder / name, index)


def _make_split(
    scene: Path, separator: str, order: str, images: str, name: str, poses: str, sequence_name: str
) -> Path:
    """Two sequences to train with, frames 3, 4 and 17, then 0 and 1, and one to test with; rows in any order."""
    for split, sequence, frames in (
        ("train", 0, {0: 3, 1: 4, 2: 17}),
        ("train", 10, {3: 0, 4: 1}),
        ("test", 1, {5: 0}),
    ):
        folder = scene / split / sequence_name.format(sequence)
        write_images(folder / images, {i: name.format(frame) for i, frame in frames.items()})
        rows = [
            separator.join([str(sequence), str(frame), *pose_numbers(true_pose(i), order)])
            for i, frame in frames.items()
        ]
        (folder / poses.format(folder.name)).write_text("\n".join(reversed(rows)) + "\n")
    return scene


def make_ambiguous(scene: Path) -> Path:
    columns = "qw qx qy qz tx ty tz"
    return _make_split(scene, ", ", columns, "rgb_matched", "frame-color-{:04d}.png", "poses_{}.txt", "seq{:02d}")


def make_ceiling(scene: Path) -> Path:
    return _make_split(scene, " ", "tx ty tz qw qx qy qz", "images", "{:06d}.jpg", "poses.txt", "{}")


HEADER = "Visual Landmark Dataset V1\nImageFile, Camera Position [X Y Z W P Q R]\n\n"


def cambridge_row(name: str, pose: Poses) -> str:
    return " ".join([name, *numbers(pose.translation, pose.inverse().as_quat_xyzw(), "tx ty tz qw qx qy qz")])


def make_cambridge(scene: Path) -> Path:
    """Sequences 2 and 10 to train with, listed out of order, and 1 to test with."""
    train = {0: "seq2/frame00009.png", 1: "seq2/frame00010.png", 2: "seq10/frame00001.png", 3: "seq10/frame00002.png"}
    test = {4: "seq1/frame00001.png"}
    for split, names in (("train", train), ("test", test)):
        write_images(scene, names)
        rows = [cambridge_row(name, true_pose(i)) for i, name in reversed(names.items())]
        (scene / f"dataset_{split}.txt").write_text(HEADER + "\n".join(rows) + "\n")
    return scene


CAMERAS = "# Camera list\n1 PINHOLE 64 48 60 58 32 24\n2 SIMPLE_RADIAL 32 24 30 16 12 0\n"
COLMAP_NAMES = {0: "a/frame9.png", 1: "a/frame10.png", 2: "b/view 1.png"}


def colmap_row(number: int, pose: Poses, camera: int, name: str) -> str:
    return " ".join([str(number), *pose_numbers(pose.inverse(), "qw qx qy qz tx ty tz"), str(camera), name])


def make_colmap(root: Path, model: str, images: str) -> Path:
    """A model in one folder and its images in another, out of order; the images of camera 1 at half its size."""
    write_images(root / images, COLMAP_NAMES)
    (root / model).mkdir(parents=True, exist_ok=True)
    (root / model / "cameras.txt").write_text(CAMERAS)
    rows = ["# Image list with two lines of data per image:"]
    for index, camera, points in ((1, 1, "2362.39 248.498 58396 1784.7 268.254 -1"), (2, 2, ""), (0, 1, "")):
        rows += [colmap_row(index + 5, true_pose(index), camera, COLMAP_NAMES[index]), points]
    (root / model / "images.txt").write_text("\n".join(rows) + "\n")
    return root


THIRTIETH_NS = 1_000_000_000 / 30


def check(path: Path, indices: list[int], times_ns: list[float] | None = None) -> None:
    frames = list(posed_frames(path))
    assert [int(frame.image[0, 0, 0]) // 10 for frame in frames] == indices
    for index, frame in zip(indices, frames, strict=True):
        assert same(frame.world_from_camera, true_pose(index), 1e-6)
    if times_ns is not None:
        np.testing.assert_allclose([frame.time_ns for frame in frames], times_ns, atol=1)
