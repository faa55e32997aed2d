"""EuRoC MAV: `mav0/cam0/data.csv` lists images with their stamps, `mav0/state_groundtruth_estimate0/data.csv` is truth.

Burri, Nikolic, Gohl, Schneider, Rehder, Omari, Achtelik and Siegwart, "The EuRoC micro aerial vehicle datasets", IJRR
2016. A row of the list is `timestamp [ns],filename`, the file in `mav0/cam0/data/`. `mav0/cam0/sensor.yaml` states the
left camera: intrinsics, distortion, and its pose T_BS in the body. True poses are of the body, in whose frame their own
`sensor.yaml`, where there is one, places what they are of; they are interpolated to the images' stamps.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from filtering.se3 import Poses
from sequences.errors import SequenceError
from sequences.frame import Camera
from sequences.layouts.image_files import num_beside
from sequences.layouts.intrinsics import scaled_to
from sequences.layouts.packed import ImageFile
from sequences.layouts.pose_rows import read_pose_matrix
from sequences.layouts.posed_images import PosedImages
from sequences.pairing import MAX_TRUE_POSE_GAP_S, interpolate
from sequences.pose_tables import read_pose_table
from sequences.tum import read_lines
from sequences.undistortion import DistortionModel, Lens

LOOKED_FOR = "a EuRoC MAV sequence (mav0/cam0/data.csv)"
_MODELS: dict[str, DistortionModel] = {
    "radial-tangential": "plumb_bob",
    "radtan": "plumb_bob",
    "plumb_bob": "plumb_bob",
    "equidistant": "equidistant",
}
_PINHOLE = ("none", *(name for name, model in _MODELS.items() if model == "plumb_bob"))  # where coefficients are 0
_MAX_TIME_NS = 1 << 62


def list_images(path: Path) -> PosedImages | None:
    """Images of the left camera, the true pose interpolated to each one's time; None where it is of another layout.

    Args:
        path: Folder that holds `mav0`, or `mav0` itself.

    Raises:
        SequenceError: a file is missing or damaged.
    """
    folder = next((f for f in (path / "mav0", path) if (f / "cam0" / "data.csv").is_file()), None)
    if folder is None:
        return None
    skipped: Counter[str] = Counter()
    truth_file = folder / "state_groundtruth_estimate0" / "data.csv"
    if not truth_file.is_file():
        raise SequenceError(f"{truth_file}: no such file, expected the true poses of the sequence")
    truth = read_pose_table(truth_file)
    stated = truth_file.with_name("sensor.yaml")
    sensor_from_body = _body_from_sensor(stated).inverse() if stated.is_file() else Poses.identity()
    calibration = folder / "cam0" / "sensor.yaml"
    body_from_camera = _body_from_sensor(calibration)
    times_ns, files = _read_list(folder / "cam0" / "data.csv", skipped)
    poses, covered = interpolate(truth.times_ns, truth.poses, times_ns, max_gap_s=MAX_TRUE_POSE_GAP_S)
    skipped["true pose does not cover"] += int((~covered).sum())
    kept = np.flatnonzero(covered)
    files = [files[i] for i in kept]
    camera = _read_camera(calibration, files)
    world_from_camera = poses[kept] @ (sensor_from_body @ body_from_camera)
    return PosedImages("EuRoC MAV", files, times_ns[kept], world_from_camera, [camera] * len(files), skipped=+skipped)


def _read_list(listing: Path, skipped: Counter[str]) -> tuple[np.ndarray, list[Path]]:
    """Stamps and files of the images that are there, in order of time."""
    times_ns: list[int] = []
    files: list[Path] = []
    for number, line in enumerate(read_lines(listing), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        where, fields = f"{listing}:{number}", [field.strip() for field in line.split(",")]
        if len(fields) != 2 or not fields[1]:
            raise SequenceError(f"{where}: {line.strip()!r}, expected `timestamp [ns],filename`")
        try:
            time_ns = int(fields[0])
        except ValueError as error:
            raise SequenceError(f"{where}: time {fields[0]!r}, expected whole nanoseconds") from error
        if abs(time_ns) > _MAX_TIME_NS:
            raise SequenceError(f"{where}: time {fields[0]} is none that a clock shows, expected nanoseconds")
        if times_ns and time_ns <= times_ns[-1]:
            skipped["time stamp not increasing"] += 1
            continue
        if not (file := listing.parent / "data" / fields[1]).is_file():
            skipped["no image"] += 1
            continue
        times_ns.append(time_ns)
        files.append(file)
    skipped["image not in the list"] += num_beside(files)
    return np.array(times_ns, np.int64), files


class _Loader(yaml.SafeLoader):
    """YAML without its tags of OpenCV, as some tools write matrices."""


_Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", yaml.SafeLoader.construct_yaml_map)


def _read_yaml(file: Path) -> dict[str, Any]:
    lines = [line for line in read_lines(file) if not line.startswith("%")]  # %YAML:1.0 is OpenCV's, not YAML
    try:
        content = yaml.load("\n".join(lines), _Loader)
    except yaml.YAMLError as error:
        raise SequenceError(f"{file}: {' '.join(str(error).split())}; expected YAML") from error
    if not isinstance(content, dict):
        raise SequenceError(f"{file}: holds {type(content).__name__}, expected the names and values of a sensor")
    return content


def _body_from_sensor(file: Path) -> Poses:
    content = _read_yaml(file).get("T_BS")
    values = content.get("data") if isinstance(content, dict) else content
    if not isinstance(values, list):
        raise SequenceError(f"{file}: T_BS is {content!r}, expected its data: 16 numbers")
    rows = [values[i : i + 4] for i in range(0, len(values), 4)] if len(values) == 16 else values
    pose = read_pose_matrix(rows, f"{file}: T_BS")
    if pose is None:
        raise SequenceError(f"{file}: T_BS is not finite, expected the pose of the sensor in the body")
    return pose


def _read_camera(file: Path, files: Sequence[ImageFile]) -> Camera | Lens:
    content = _read_yaml(file)
    if content.get("camera_model", "pinhole") != "pinhole":
        raise SequenceError(f"{file}: camera_model {content['camera_model']}, expected pinhole")
    numbers: dict[str, list[float]] = {}
    for name, counts in (("resolution", (2,)), ("intrinsics", (4,)), ("distortion_coefficients", (0, 4, 5))):
        try:
            numbers[name] = [float(value) for value in content.get(name) or []]
        except (TypeError, ValueError) as error:
            raise SequenceError(f"{file}: {name}: {error}; expected a list of numbers") from error
        if len(numbers[name]) not in counts or not np.isfinite(numbers[name]).all():
            raise SequenceError(f"{file}: {name} is {content.get(name)}, expected {counts[-1]} finite numbers")
    (width, height), (fx, fy, cx, cy) = numbers["resolution"], numbers["intrinsics"]
    if min(width, height, fx, fy) <= 0:
        raise SequenceError(f"{file}: resolution or focal length not positive, expected those of a camera")
    camera = Camera(int(width), int(height), fx, fy, cx, cy)
    coefficients = numbers["distortion_coefficients"]
    model = content.get("distortion_model")
    if not coefficients or (model in _PINHOLE and not any(coefficients)):
        return scaled_to(camera, files)
    if model not in _MODELS:
        raise SequenceError(f"{file}: distortion_model {model}, expected one of {', '.join(_MODELS)}")
    return scaled_to(Lens(camera, _MODELS[model], tuple(coefficients)), files)
