"""Poses of named or timed frames as text, as pose estimators write them."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float64

from filtering.errors import quoted
from filtering.se3 import Poses
from sequences.errors import SequenceError
from sequences.files.rows import Rows
from sequences.trajectories.columns import Columns, stamp_ns, stamp_of
from sequences.trajectories.pose_lines import fields_of, pose_rows, typical
from sequences.trajectories.pose_tables import read_pose_table
from sequences.values import is_number, natural, parse_frame_number, parse_number

Direction = Literal["world-to-camera", "camera-to-world"]
FramesBy = Literal["names", "stamped names", "stamps"]
"""Names of frames: with a number, with a stamp (`cam0/1403636579763555584.png`), or stamps alone."""
_COLUMNS = "name qw qx qy qz tx ty tz"


class FrameName(NamedTuple):
    """One frame: its sequence, and its number in it; or an empty sequence and its stamp in integer nanoseconds.

    The sequence is the name up to the number, such as `seq-01/frame-`.
    """

    sequence: str
    number: int


@dataclass(frozen=True)
class PoseFile:
    """Poses of n frames, world_from_camera, sequence by sequence and in the order of their numbers.

    `timed` frames are named by their stamps. Only with weights (n,), above 0, may a frame have several poses; they are
    in the order of the file.
    """

    path: Path
    timed: bool
    frames: tuple[FrameName, ...]
    poses: Poses
    weights: Float64[np.ndarray, " n"] | None = None


def read_poses(
    path: Path, direction: Direction | None = None, columns: str | None = None, rows: Rows | None = None
) -> PoseFile:
    """Read poses of named frames, or a table of poses by time.

    Lines are `name qw qx qy qz tx ty tz`, in any order, with further columns ignored: the format of published 7-Scenes
    estimates. The last number before the first dot of a name's last part is the frame's; the text before it names the
    sequence. Names that are stamps, as of EuRoC (`cam0/1403636579763555584.png`, nanoseconds) and TUM
    (`rgb/1305031102.175304.png`, seconds), are read as stamps. Where the first line begins with a number, the file is a
    table of camera-to-world poses by time, see `read_pose_table`. Lines that start with # are comments.

    Other columns are given by their names, see `Columns`, such as `name qw qx qy qz tx ty tz _ _ weight`; `time` in
    place of `name` for camera-to-world poses by stamps. With a `weight`, such as the number of inliers, a frame may
    have several lines, its hypotheses. Lines with a weight of 0 are left out.

    Args:
        path: The file.
        direction: Direction of the poses of named frames; without it only frames with stamps can be read.
        columns: Names of the columns; None for the default ones.
        rows: Counts unusable lines, which are left out; None where one of them is an error.

    Raises:
        SequenceError: unknown columns; a missing or empty file; an unusable line, or a frame repeated without weights;
            or a direction that is missing or contradicts stamps.
    """
    path, rows = Path(path), rows or Rows(tolerant=False)
    names = Columns(_COLUMNS if columns is None else columns)
    first = _first_row(path, columns)
    if columns is None and is_number(fields_of(first[1])[0]):
        _require_camera_to_world(path, direction, "poses by time")
        trajectory = read_pose_table(path, rows=rows)
        return PoseFile(path, True, tuple(FrameName("", int(time)) for time in trajectory.times_ns), trajectory.poses)
    stamped = names.timed or frames_by(path, columns)[0] == "stamped names"
    if names.timed:
        _require_camera_to_world(path, direction, "frames by stamps")
    elif direction is None:
        raise SequenceError(
            f"{path}: poses of named frames, expected their direction with them: world-to-camera or camera-to-world"
        )
    seen: dict[FrameName, int] = {}
    found: list[_Row] = []
    for number, line in rows.each(pose_rows(path)):
        where = f"{path}:{number}"
        row = rows.use(_read_row, line, where, names, stamped, first)
        if isinstance(row, str):
            continue
        if seen.setdefault(row.frame, number) != number and not names.weighted:
            raise SequenceError(
                f"{where}: {quoted(fields_of(line)[names.frame])} names the same frame as line {seen[row.frame]},"
                " expected it once; of several hypotheses each has a weight (--columns)"
            )
        if row.weight > 0.0:
            found.append(row)
    if not found:
        raise SequenceError(f"{path}: all weights are 0, expected a pose with another")
    found.sort(key=lambda row: natural_order(row.frame))  # of a frame as they come
    table = np.array([row.pose for row in found])
    poses = Poses.from_quat_xyzw(table[:, :3], table[:, 3:])
    return PoseFile(
        path,
        stamped,
        tuple(row.frame for row in found),
        poses.inverse() if direction == "world-to-camera" else poses,
        np.array([row.weight for row in found]) if names.weighted else None,
    )


class _Row(NamedTuple):
    frame: FrameName
    pose: list[float]
    weight: float


def _read_row(line: str, where: str, columns: Columns, stamped: bool, first: tuple[int, str]) -> _Row:
    """The frame of a line with as many columns as the first line; no pose where its weight is 0."""
    fields, num_columns = columns.read(line, where), len(fields_of(line))
    if num_columns != len(fields_of(first[1])):
        raise SequenceError(f"{where}: {num_columns} columns, expected as many as on line {first[0]}")
    if columns.timed:
        frame = FrameName("", stamp_ns(fields["time"], where))
    else:
        frame = _frame_name(fields["name"], where, stamped)
    weight = parse_number(fields["weight"], f"{where}: weight", 0.0) if columns.weighted else 1.0
    return _Row(frame, columns.pose(fields, where) if weight > 0.0 else [], weight)


def _first_row(path: Path, columns: str | None) -> tuple[int, str]:
    """Number and text of the first usual line. Raises SequenceError where there is none."""
    found = typical(pose_rows(path))
    if found is None:
        expected = f"`{_COLUMNS}`, or of a trajectory" if columns is None else f"`{columns}`"
        raise SequenceError(f"{path}: no poses, expected lines of {expected}")
    return found


def frames_by(path: Path, columns: str | None = None) -> tuple[FramesBy, str]:
    """How the first line of a file names its frame, and that name. Raises SequenceError where it has no poses."""
    line = _first_row(path, columns)[1]
    fields = fields_of(line)
    if columns is None and is_number(fields[0]):
        return "stamps", fields[0]
    names = Columns(_COLUMNS if columns is None else columns)
    name = fields[names.frame] if names.frame < len(fields) else ""
    if names.timed:
        return "stamps", name
    return ("stamped names" if stamp_of(name) is not None else "names"), name


def natural_order(frame: FrameName) -> tuple[list[tuple[int, str]], int]:
    """Sort key by which `seq-2/frame-10` comes after `seq-2/frame-9` and before `seq-10/frame-1`."""
    return natural(frame.sequence), frame.number


def _require_camera_to_world(path: Path, direction: Direction | None, what: str) -> None:
    if direction == "world-to-camera":
        raise SequenceError(f"{path}: {what}, which is camera-to-world, expected no world-to-camera with it")


def _frame_name(name: str, where: str, stamped: bool) -> FrameName:
    if stamped:
        if stamp_of(name) is None:
            raise SequenceError(f"{where}: name {quoted(name)} is no stamp, expected one as on the first line")
        return FrameName("", stamp_ns(name, where))
    folder, slash, file = name.rpartition("/")
    match = re.fullmatch(r"(.*?)(\d+)\D*", file.split(".")[0], flags=re.ASCII)
    if match is None:
        raise SequenceError(f"{where}: name {quoted(name)}, expected a frame number in it, such as frame-000017.png")
    return FrameName(folder + slash + match[1], parse_frame_number(match[2], where))
