"""`modes.csv`: every mode of every image of a run, a line each, the best one of an image first."""

from __future__ import annotations

from collections.abc import Sequence
from io import TextIOBase
from pathlib import Path

import numpy as np

from filtering.estimate import Mode
from filtering.se3 import Poses
from sequences.errors import SequenceError
from sequences.files import read_lines
from sequences.trajectories.pose_lines import usable_pose
from sequences.trajectories.tum import format_time
from sequences.values import parse_number, parse_numbers, parse_time_ns, parse_whole
from vapor.tracking.mode_trajectories import ModeTrajectory, gathered

COLUMNS = "time,identity,weight,tx,ty,tz,qx,qy,qz,qw,std_m,std_deg"


def write_modes(file: TextIOBase, time_ns: int, modes: Sequence[Mode]) -> None:
    """Write the modes of one image; `std_m` and `std_deg` are along the widest axis of position and rotation."""
    poses = Poses.stack([mode.world_from_camera for mode in modes])
    covariances = np.stack([mode.covariance for mode in modes])
    std_m, std_rad = (
        np.sqrt(np.linalg.eigvalsh(covariances[:, part, part])[:, -1]) for part in (slice(0, 3), slice(3, 6))
    )
    table = np.concatenate([poses.translation, poses.as_quat_xyzw(known_valid=True)], axis=1) + 0.0  # −0 becomes 0
    time = format_time(time_ns)
    for mode, row, metres, degrees in zip(modes, table.tolist(), std_m, np.degrees(std_rad), strict=True):
        pose = ",".join(f"{value:.6f}" for value in row)
        file.write(f"{time},{mode.identity},{mode.weight:.6f},{pose},{metres:.4f},{degrees:.3f}\n")


def read_mode_trajectories(path: Path | str) -> dict[int, ModeTrajectory]:
    """The trajectory of each mode of a run, by its identity, from the run's `modes.csv`.

    Raises:
        SequenceError: the file is missing, or is not one that `run` or `fuse` wrote.

    Example:
        >>> import vapor
        >>> modes = vapor.read_mode_trajectories("result/modes.csv")
        >>> longest = max(modes.values(), key=lambda mode: len(mode.trajectory))
        >>> vapor.write_tum("longest.tum", longest.trajectory)
    """
    path = Path(path)
    lines = read_lines(path, None)
    header = next(lines, (1, ""))[1].strip()
    if header != COLUMNS:
        raise SequenceError(f"{path}: begins with {header[:80]!r}, expected the columns {COLUMNS}")
    found: dict[int, list[tuple[int, Poses, float, int]]] = {}
    before_ns, rank = None, 0
    for number, line in lines:
        where, fields = f"{path}:{number}", line.strip().split(",")
        if len(fields) != 12:
            raise SequenceError(f"{where}: {len(fields)} columns, expected the twelve {COLUMNS}")
        time_ns = parse_time_ns(fields[0], where)
        identity = parse_whole(fields[1], f"{where}: identity", 0, 2**53)
        weight = parse_number(fields[2], f"{where}: weight", 0, 1)
        row = np.array(usable_pose(parse_numbers(fields[3:10], where), where, "tx ty tz qx qy qz qw"))
        if before_ns is not None and time_ns < before_ns:
            raise SequenceError(f"{where}: time {fields[0]} is before that of the line above, expected a later one")
        rank = rank + 1 if time_ns == before_ns else 0
        before_ns = time_ns
        rows = found.setdefault(identity, [])
        if rows and rows[-1][0] == time_ns:
            raise SequenceError(f"{where}: mode {identity} is there twice at {fields[0]}, expected it once")
        rows.append((time_ns, Poses.from_quat_xyzw(row[:3], row[3:]), weight, rank))
    return gathered(found)
