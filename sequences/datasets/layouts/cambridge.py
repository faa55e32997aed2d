"""Cambridge Landmarks: `dataset_train.txt` and `dataset_test.txt` of a scene list its images with their poses.

A sequence, `seq1`, is named by its folder, whichever list has it.

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
    """Images of a split, given as the file that lists them, or of a sequence, its folder; None of any other path."""
    scene, only = path.absolute().parent, ""
    if re.fullmatch(r"dataset_\w+\.txt", path.name) is not None and path.is_file():
        root, lists = path.parent, [path]
    elif path.is_dir():
        root, lists, only = scene, _lists(scene), f"{path.absolute().name}/"
    else:
        return None
    poses: dict[str, Poses | str] = {}
    lines: dict[str, str] = {}
    rows = Rows()
    named = ((f"{file}:{number}", fields) for file in lists for number, fields in _rows(file))
    for where, fields in rows.each(row for row in named if row[1][0].startswith(only)):
        name = fields[0]
        if name in lines:
            raise SequenceError(f"{where}: {quoted(name)} is on {lines[name]} too, expected it once")
        lines[name] = Path(where).name
        pose = rows.use(read_pose_row, fields, _COLUMNS, where)
        if isinstance(pose, Poses):
            is_far = np.linalg.norm(pose.translation) > _FARTHEST_M
            inverted = Poses(np.ascontiguousarray(pose.rotation.T), pose.translation)
            pose = "true pose more than 10 km away" if is_far else inverted
        poses[name] = pose
    if only and not poses:
        return None
    images = list_named(_NAME, root, root, poses, () if only else _in_no_list(root), rows.notices)
    return images.with_camera(find_camera((path, scene, scene.parent), images.files))


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


def _lists(scene: Path) -> list[Path]:
    return sorted(file for file in scene.glob("dataset_*.txt") if file.is_file())


def _in_no_list(scene: Path) -> list[Path]:
    """Folders of a scene that none of its lists names."""
    named = {line.strip().partition("/")[0] for file in _lists(scene) for _, line in read_lines(file)}
    return [folder for folder in scene.iterdir() if folder.is_dir() and folder.name not in named]


LAYOUT = Layout(
    _NAME,
    looked_for="dataset_train.txt",
    order=60,
    list_images=list_images,
    list_suffixes=(".txt",),
    splits=("dataset_train.txt", "dataset_test.txt"),
)
