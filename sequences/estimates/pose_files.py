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
from sequences.files.text import read_rows
from sequences.trajectories.tum import poses_of_rows, read_tum
from sequences.values import is_number, natural, parse_frame_number, parse_number, parse_numbers, parse_time_ns

Direction = Literal["world-to-camera", "camera-to-world"]
"""Which way the poses of a file map points."""

FramesBy = Literal["names", "stamped names", "stamps"]
"""What frames go by: names that hold a number, names that are stamps (`cam0/1403636579763555584.png`), or stamps."""

COLUMNS = "name qw qx qy qz tx ty tz"
"""Columns of named frames where no others are stated."""

_POSE = ("tx", "ty", "tz", "qx", "qy", "qz", "qw")
_IGNORED = "_"


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
        frames: Of each of n poses; no two the same, but where poses have weights: those of a frame are then several
            hypotheses, in the order of the file.
        poses: world_from_camera, batch (n,).
        weights: Of the poses, above 0; None where the file states none, (n,).
    """

    path: Path
    timed: bool
    frames: tuple[FrameName, ...]
    poses: Poses
    weights: Float64[np.ndarray, " n"] | None = None


def require_columns(columns: str) -> None:
    """Raise SequenceError if columns are not such as `read_poses` takes."""
    names = columns.split()
    expected = f"name or time, {' '.join(_POSE)}, and perhaps weight, each once; {_IGNORED} for what is ignored"
    stated = [name for name in names if name != _IGNORED]
    for name in stated:
        if name not in ("name", "time", *_POSE, "weight"):
            raise SequenceError(f"columns: {quoted(name)} in {quoted(columns)}, expected {expected}")
    missing = [name for name in _POSE if name not in stated]
    if missing or len(set(stated)) < len(stated) or ("name" in stated) == ("time" in stated):
        raise SequenceError(f"columns are {quoted(columns)}, expected {expected}")


def read_poses(path: Path, direction: Direction | None = None, columns: str | None = None) -> PoseFile:
    """Read poses of named frames, or a TUM trajectory.

    Lines are `name qw qx qy qz tx ty tz`, in any order, with further columns ignored: the format of published 7-Scenes
    estimates. The last number before the first dot of a name's last part is the frame's; what stands before it names
    the sequence. Names that are stamps, as EuRoC's (`cam0/1403636579763555584.png`, nanoseconds) and TUM's
    (`rgb/1305031102.175304.png`, seconds), are read as such. Where the first line
    begins with a number the file is a TUM trajectory, `time tx ty tz qx qy qz qw`,
    camera-to-world. Lines that start with # are comments.

    Other columns are stated by their names, such as `name qw qx qy qz tx ty tz _ _ weight`: `time`, in seconds, in
    place of `name` for frames that are camera-to-world and named by their stamps; `_` for a column that is ignored.
    With a `weight`, such as the number of inliers, a frame may have several lines: they are its hypotheses. Lines with
    a weight of 0 are left out.

    Args:
        path: The file.
        direction: Which way the poses of named frames map; without it only frames with stamps can be read.
        columns: Names of the columns; None for those of named frames or of a TUM trajectory, as the first line has it.

    Raises:
        SequenceError: the columns are none; the file is missing or empty, a line has too few columns or others than the
            first, no number where one belongs, a value that is not finite, a quaternion without length or a negative
            weight, or names the same frame as an earlier one without having a weight; or the direction is missing, or
            contradicts stamps.
    """
    path = Path(path)
    if columns is not None:
        require_columns(columns)
    first = next(read_rows(path), None)
    if first is None:
        expected = f"`{COLUMNS}` or of a TUM trajectory" if columns is None else f"`{columns}`"
        raise SequenceError(f"{path}: no poses, expected lines of {expected}")
    if columns is None and is_number(first[1].split()[0]):
        _require_camera_to_world(path, direction, "a TUM trajectory")
        trajectory = read_tum(path)
        return PoseFile(path, True, tuple(FrameName("", int(time)) for time in trajectory.times_ns), trajectory.poses)
    columns = columns or COLUMNS
    at = {name: i for i, name in enumerate(columns.split()) if name != _IGNORED}
    timed, weighted = "time" in at, "weight" in at
    stamped = not timed and frames_by(path, columns)[0] == "stamped names"
    if timed:
        _require_camera_to_world(path, direction, "frames by stamps")
    elif direction is None:
        raise SequenceError(
            f"{path}: poses of named frames, expected their direction with them: world-to-camera or camera-to-world"
        )
    seen: dict[FrameName, int] = {}
    frames: list[FrameName] = []
    lines: list[int] = []
    rows: list[list[float]] = []
    weights: list[float] = []
    for number, line in read_rows(path):
        where, fields = f"{path}:{number}", line.split()
        if len(fields) < len(columns.split()):
            raise SequenceError(f"{where}: {len(fields)} columns, expected the {len(columns.split())} of `{columns}`")
        if len(fields) != len(first[1].split()):
            raise SequenceError(f"{where}: {len(fields)} columns, expected as many as on line {first[0]}")
        name = fields[at["time" if timed else "name"]]
        frame = FrameName("", parse_time_ns(name, where)) if timed else _frame_name(name, where, stamped)
        if seen.setdefault(frame, number) != number and not weighted:
            raise SequenceError(
                f"{where}: {quoted(name)} names the same frame as line {seen[frame]}, expected it once; of several"
                " hypotheses each has a weight (--columns)"
            )
        row = parse_numbers([fields[at[each]] for each in _POSE], where, f"those of `{columns}`")
        weight = parse_number(fields[at["weight"]], f"{where}: weight", 0.0) if weighted else 1.0
        if weight > 0.0:
            frames.append(frame)
            lines.append(number)
            rows.append(row)
            weights.append(weight)
    if not rows:
        raise SequenceError(f"{path}: all weights are 0, expected a pose with another")
    order = sorted(range(len(frames)), key=lambda i: natural_order(frames[i]))  # of a frame as they come
    table = np.array(rows)
    poses = poses_of_rows(path, lines, table[:, :3], table[:, 3:], columns)[order]
    return PoseFile(
        path,
        timed or stamped,
        tuple(frames[i] for i in order),
        poses.inverse() if direction == "world-to-camera" else poses,
        np.array(weights)[order] if weighted else None,
    )


def frames_by(path: Path, columns: str | None = None) -> tuple[FramesBy, str]:
    """How the first line of a file names its frame, as `read_poses` takes it, and that name.

    Raises:
        SequenceError: the file cannot be read, or holds no poses.
    """
    first = next(read_rows(path), None)
    if first is None:
        raise SequenceError(f"{path}: no poses, expected at least one line of them")
    fields, names = first[1].split(), (columns or COLUMNS).split()
    if columns is None and is_number(fields[0]):
        return "stamps", fields[0]
    at = names.index("time" if "time" in names else "name")
    name = fields[at] if at < len(fields) else ""
    if "time" in names:
        return "stamps", name
    return ("stamped names" if _stamp_of(name) is not None else "names"), name


def natural_order(frame: FrameName) -> tuple[list[tuple[int, str]], int]:
    """Sort key by which `seq-2/frame-10` comes after `seq-2/frame-9` and before `seq-10/frame-1`."""
    return natural(frame.sequence), frame.number


def _require_camera_to_world(path: Path, direction: Direction | None, what: str) -> None:
    if direction == "world-to-camera":
        raise SequenceError(f"{path}: {what}, which is camera-to-world, expected no world-to-camera with it")


def _stamp_of(name: str) -> str | None:
    """Seconds that a name states, as EuRoC's images are named, or TUM's; None where it states none."""
    file = name.rpartition("/")[2]
    if match := re.fullmatch(r"(\d{9,10})(\d{9})(\.[A-Za-z]\w*)?", file, flags=re.ASCII):
        return f"{match[1]}.{match[2]}"
    match = re.fullmatch(r"(\d{9,10}\.\d{1,9})(\.[A-Za-z]\w*)?", file, flags=re.ASCII)
    return match[1] if match else None


def _frame_name(name: str, where: str, stamped: bool) -> FrameName:
    if stamped:
        stamp = _stamp_of(name)
        if stamp is None:
            raise SequenceError(f"{where}: name {quoted(name)} is no stamp, expected one as on the first line")
        return FrameName("", parse_time_ns(stamp, where))
    folder, slash, file = name.rpartition("/")
    match = re.fullmatch(r"(.*?)(\d+)\D*", file.split(".")[0], flags=re.ASCII)
    if match is None:
        raise SequenceError(f"{where}: name {quoted(name)}, expected a frame number in it, such as frame-000017.png")
    return FrameName(folder + slash + match[1], parse_frame_number(match[2], where))
