"""Cambridge Landmarks: `dataset_train.txt` and `dataset_test.txt` of a scene list its images with their poses.

Kendall, Grimes and Cipolla, "PoseNet: A Convolutional Network for Real-Time 6-DOF Camera Relocalization", ICCV 2015.
Three lines of header are followed by `seq1/frame00001.png X Y Z W P Q R`. X Y Z is the camera's centre C in the world,
and W P Q R the quaternion (w, x, y, z) of the rotation R from world to camera, as in an NVM reconstruction: published
loaders compute the translation from world to camera as -R C. So R is inverted here, and C is not.

One published centre is thousands of kilometres away (Great Court, seq5/frame00297.png). Whatever is beyond 10 km is
left out and counted. The lists have no time stamps: the images of a sequence are taken to follow each other at the
assumed rate, although they are a video's at a lower one. Nor have they intrinsics: these come from an
`intrinsics.json` in the scene or the folder above, and are unknown without one.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from filtering.errors import quoted
from filtering.se3 import Poses
from sequences.datasets.layout import Layout, PosedImages
from sequences.datasets.layout_helpers.image_files import find_camera
from sequences.datasets.layout_helpers.pose_lists import list_named
from sequences.datasets.layout_helpers.pose_rows import read_pose_row
from sequences.errors import SequenceError
from sequences.files import Rows, read_lines
from sequences.values import is_number

_NAME = "Cambridge Landmarks"
_COLUMNS = "file tx ty tz qw qx qy qz"  # X Y Z W P Q R
_NUM_HEADER_LINES = 3
_FARTHEST_M = 10_000.0


def list_images(path: Path) -> PosedImages | None:
    """Images of a split, given as the file that lists them; None where it is another file or a folder."""
    if re.fullmatch(r"dataset_\w+\.txt", path.name) is None or not path.is_file():
        return None
    poses: dict[str, Poses | str] = {}
    lines: dict[str, int] = {}
    rows = Rows()
    for number, fields in rows.each(_rows(path)):
        where, name = f"{path}:{number}", fields[0]
        if name in lines:
            raise SequenceError(f"{where}: {quoted(name)} is on line {lines[name]} too, expected it once")
        lines[name] = number
        pose = rows.use(read_pose_row, fields, _COLUMNS, where)
        if isinstance(pose, Poses):
            is_far = np.linalg.norm(pose.translation) > _FARTHEST_M
            inverted = Poses(np.ascontiguousarray(pose.rotation.T), pose.translation)
            pose = "true pose more than 10 km away" if is_far else inverted
        poses[name] = pose
    scene = path.absolute().parent
    images = list_named(_NAME, path.parent, path.parent, poses, _in_no_list(path.parent), rows.notices)
    return images.with_camera(find_camera((scene, scene.parent), images.files))


def _rows(path: Path) -> Iterator[tuple[int, list[str]]]:
    for number, line in read_lines(path):
        fields = line.split()
        if number > _NUM_HEADER_LINES:
            if fields:
                yield number, fields
        elif len(fields) == len(_COLUMNS.split()) and is_number(fields[-1]):
            raise SequenceError(
                f"{path}:{number}: {quoted(line)} among the first three lines, expected them to be a header"
            )


def _in_no_list(scene: Path) -> list[Path]:
    """Folders of a scene that none of its lists names."""
    lists = [file for file in scene.glob("dataset_*.txt") if file.is_file()]
    named = {line.strip().partition("/")[0] for file in lists for _, line in read_lines(file)}
    return [folder for folder in scene.iterdir() if folder.is_dir() and folder.name not in named]


LAYOUT = Layout(
    _NAME,
    looked_for="dataset_train.txt",
    order=60,
    list_images=list_images,
    list_suffixes=(".txt",),
    splits=("dataset_train.txt", "dataset_test.txt"),
)
