"""Layouts whose poses are of images by name, relative to one folder."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from itertools import groupby
from pathlib import Path, PurePosixPath

from filtering.se3 import Poses
from sequences.datasets.layout_helpers.image_files import num_beside
from sequences.datasets.layout_helpers.pose_rows import stack_poses
from sequences.datasets.posed_images import PosedImages
from sequences.files.paths import require_inside
from sequences.values import natural


def list_named(
    layout: str,
    folder: Path,
    root: Path,
    world_from_camera: Mapping[str, Poses | str],
    folders: Iterable[Path] = (),
    notices: Sequence[str] = (),
) -> PosedImages:
    """Images in the order of their names, those of one folder as one sequence, without intrinsics yet.

    Args:
        layout: Name of the layout.
        folder: Where the data set lies: no name leads out of it.
        root: What the names are relative to.
        world_from_camera: One pose by the name of each image, or why it has none.
        folders: Where other images than these should not be, beside their own folders: they are counted as left out.
        notices: What a person should know of what was left out.

    Raises:
        SequenceError: a name leads out of the folder.
    """
    require_inside(folder, (root / name for name in world_from_camera))
    skipped: Counter[str] = Counter()
    files: list[Path] = []
    poses: list[Poses] = []
    numbers: list[list[int]] = []
    ordered = sorted(world_from_camera, key=lambda name: (natural(_folder(name)), natural(name)))
    for _, names in groupby(ordered, key=_folder):
        numbers.append([])
        for number, name in enumerate(names):
            pose = world_from_camera[name]
            if not os.path.isfile(root / name):
                skipped["no image"] += 1
            elif isinstance(pose, str):
                skipped[pose] += 1
            else:
                files.append(root / name)
                poses.append(pose)
                numbers[-1].append(number)
    skipped["image not in the list"] += num_beside((root / name for name in ordered), folders)
    return PosedImages.numbered(layout, files, stack_poses(poses), numbers, skipped, notices=notices)


def _folder(name: str) -> str:
    return str(PurePosixPath(name).parent)
