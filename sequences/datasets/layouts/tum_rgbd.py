"""TUM RGB-D: `rgb.txt` lists images with their stamps, `groundtruth.txt` is a trajectory with its own."""

from __future__ import annotations

import os
from collections import Counter
from pathlib import Path

import numpy as np

from filtering.errors import quoted
from sequences.datasets.layout import Layout, PosedImages
from sequences.datasets.layout_helpers.image_files import find_camera, num_beside
from sequences.errors import SequenceError
from sequences.files import Rows, read_rows, require_inside
from sequences.frame import Camera
from sequences.trajectories.interpolation import MAX_TRUE_POSE_GAP_S, interpolate
from sequences.trajectories.tum import read_tum
from sequences.values import parse_time_ns

_NAME = "TUM RGB-D"
# Published intrinsics at 640 x 480, by a part of the folder's name.
_KNOWN_CAMERAS = {
    "freiburg1": Camera(640, 480, 517.3, 516.5, 318.6, 255.3),
    "freiburg2": Camera(640, 480, 520.9, 521.0, 325.1, 249.7),
    "freiburg3": Camera(640, 480, 535.4, 539.2, 320.1, 247.6),
}
_CAMERA = Camera(640, 480, 525.0, 525.0, 319.5, 239.5)


def list_images(path: Path) -> PosedImages | None:
    """Images of a folder, the true pose interpolated to each one's time; None where it is of another layout.

    Raises:
        SequenceError: a file is missing or damaged.
    """
    if not ((path / "rgb.txt").is_file() and (path / "groundtruth.txt").is_file()):
        return None
    skipped: Counter[str] = Counter()
    truth_rows = Rows("true poses")
    truth = read_tum(path / "groundtruth.txt", truth_rows)
    times_ns: list[int] = []
    files: list[Path] = []
    listed: list[Path] = []
    rows = Rows("images")
    for number, line in rows.each(read_rows(path / "rgb.txt")):
        row = rows.use(_time_and_name, line, f"{path / 'rgb.txt'}:{number}")
        if isinstance(row, str):
            skipped[row] += 1
            continue
        found_ns, name = row
        listed.append(file := path / name)
        if times_ns and found_ns <= times_ns[-1]:
            skipped["time stamp not increasing"] += 1
            continue
        if not os.path.isfile(file):
            skipped["no image"] += 1
            continue
        times_ns.append(found_ns)
        files.append(file)
    require_inside(path, listed)
    skipped["image not in the list"] += num_beside(listed)
    times = np.array(times_ns, np.int64)
    poses, covered = interpolate(truth.times_ns, truth.poses, times, max_gap_s=MAX_TRUE_POSE_GAP_S)
    if not covered.all():
        skipped["true pose does not cover"] += int((~covered).sum())
    kept = np.flatnonzero(covered)
    files = [files[i] for i in kept]
    known = next((camera for name, camera in _KNOWN_CAMERAS.items() if name in path.name), _CAMERA)
    camera = find_camera((path, path.parent), files, known)
    notices = [*truth_rows.notices, *rows.notices]
    return PosedImages(_NAME, files, times[kept], poses[kept], [camera] * len(files), skipped=+skipped, notices=notices)


def _time_and_name(line: str, where: str) -> tuple[int, str]:
    fields = line.split(maxsplit=1)
    if len(fields) != 2:
        raise SequenceError(f"{where}: {quoted(line)}, expected `time file`")
    return parse_time_ns(fields[0], where), fields[1].strip()


LAYOUT = Layout(_NAME, looked_for="rgb.txt and groundtruth.txt", order=10, list_images=list_images)
