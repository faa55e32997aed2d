"""Poses of named or timed frames as text, as pose estimators write them."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from filtering.errors import quoted
from filtering.se3 import Poses
from sequences.errors import SequenceError
from sequences.files.text import read_rows
from sequences.trajectories.tum import poses_of_rows, read_tum
from sequences.values import is_number, natural, parse_frame_number, parse_numbers

Direction = Literal["world-to-camera", "camera-to-world"]
"""Which way the poses of a file map points."""

_COLUMNS = "name qw qx qy qz tx ty tz"


class FrameName(NamedTuple):
    """One frame of one sequence.

    Attributes:
        sequence: What its name begins with, up to the number, such as `seq-01/frame-`; empty where frames are timed.
        number: Its number in the sequence, or its stamp in integer nanoseconds.
    """

    sequence: str
    number: int


@dataclass(frozen=True)
class PoseFile:
    """Poses of frames, sequence by sequence and in the order of their numbers.

    Attributes:
        path: The file.
        timed: Whether the frames are named by their stamps.
        frames: n frames, no two of them the same.
        poses: world_from_camera, batch (n,).
    """

    path: Path
    timed: bool
    frames: tuple[FrameName, ...]
    poses: Poses


def read_poses(path: Path, direction: Direction | None = None) -> PoseFile:
    """Read poses of named frames, or a TUM trajectory.

    Lines are `name qw qx qy qz tx ty tz`, in any order, with further columns ignored: the format of published 7-Scenes
    estimates. The last number before the first dot of a name's last part is the frame's; what stands before it names
    the sequence. Where the first line begins with a number the file is a TUM trajectory, `time tx ty tz qx qy qz qw`,
    camera-to-world. Lines that start with # are comments.

    Args:
        path: The file.
        direction: Which way the poses of named frames map; without it only a TUM trajectory can be read.

    Raises:
        SequenceError: the file is missing or empty, a line has too few columns or others than the first, no number
            where one belongs, a value that is not finite or a quaternion without length, or names the same frame as an
            earlier one; or the direction is missing, or contradicts a TUM trajectory.
    """
    path = Path(path)
    first = next(read_rows(path), None)
    if first is None:
        raise SequenceError(f"{path}: no poses, expected lines of `{_COLUMNS}` or of a TUM trajectory")
    if is_number(first[1].split()[0]):
        return _timed(path, direction)
    if direction is None:
        raise SequenceError(
            f"{path}: poses of named frames, expected their direction with them: world-to-camera or camera-to-world"
        )
    seen: dict[FrameName, int] = {}
    rows: list[list[float]] = []
    for number, line in read_rows(path):
        where, fields = f"{path}:{number}", line.split()
        if len(fields) < 8:
            raise SequenceError(f"{where}: {len(fields)} columns, expected the eight of `{_COLUMNS}`")
        if len(fields) != len(first[1].split()):
            raise SequenceError(f"{where}: {len(fields)} columns, expected as many as on line {first[0]}")
        frame = _frame_name(fields[0], where)
        if frame in seen:
            raise SequenceError(
                f"{where}: {quoted(fields[0])} names the same frame as line {seen[frame]}, expected it once"
            )
        seen[frame] = number
        rows.append(parse_numbers(fields[1:8], where, f"those of `{_COLUMNS}`"))
    frames = list(seen)
    order = sorted(range(len(frames)), key=lambda i: natural_order(frames[i]))
    table, lines = np.array(rows), list(seen.values())
    poses = poses_of_rows(path, lines, table[:, 4:], table[:, [1, 2, 3, 0]], _COLUMNS)[order]
    return PoseFile(
        path, False, tuple(frames[i] for i in order), poses.inverse() if direction == "world-to-camera" else poses
    )


def natural_order(frame: FrameName) -> tuple[list[tuple[int, str]], int]:
    """Sort key by which `seq-2/frame-10` comes after `seq-2/frame-9` and before `seq-10/frame-1`."""
    return natural(frame.sequence), frame.number


def _timed(path: Path, direction: Direction | None) -> PoseFile:
    if direction == "world-to-camera":
        raise SequenceError(f"{path}: a TUM trajectory, which is camera-to-world, expected no world-to-camera with it")
    trajectory = read_tum(path)
    return PoseFile(path, True, tuple(FrameName("", int(time)) for time in trajectory.times_ns), trajectory.poses)


def _frame_name(name: str, where: str) -> FrameName:
    folder, slash, file = name.rpartition("/")
    match = re.fullmatch(r"(.*?)(\d+)\D*", file.split(".")[0], flags=re.ASCII)
    if match is None:
        raise SequenceError(f"{where}: name {quoted(name)}, expected a frame number in it, such as frame-000017.png")
    return FrameName(folder + slash + match[1], parse_frame_number(match[2], where))
