"""TUM RGB-D: `rgb.txt` lists images with their stamps, `groundtruth.txt` is a trajectory with its own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from filtering.errors import quoted
from sequences.datasets.layout import Layout, PosedImages
from sequences.datasets.layout_helpers.image_files import find_camera
from sequences.datasets.layout_helpers.pose_lists import list_stamped
from sequences.errors import SequenceError
from sequences.files import Rows
from sequences.frame import Camera
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
    """Images of a folder, the true pose interpolated to each one's time; None where it is of another layout."""
    if not ((path / "rgb.txt").is_file() and (path / "groundtruth.txt").is_file()):
        return None
    truth_rows = Rows("true poses")
    truth = read_tum(path / "groundtruth.txt", truth_rows)
    images = list_stamped(_NAME, path, path / "rgb.txt", path, _time_and_name, truth)
    known = next((camera for name, camera in _KNOWN_CAMERAS.items() if name in path.name), _CAMERA)
    camera = find_camera((path, path.parent), images.files, known)
    return replace(images.with_camera(camera), notices=[*truth_rows.notices, *images.notices])


def _time_and_name(line: str, where: str) -> tuple[int, str]:
    fields = line.split(maxsplit=1)
    if len(fields) != 2:
        raise SequenceError(f"{where}: {quoted(line)}, expected `time file`")
    return parse_time_ns(fields[0], where), fields[1].strip()


LAYOUT = Layout(_NAME, looked_for="rgb.txt and groundtruth.txt", order=10, list_images=list_images)
