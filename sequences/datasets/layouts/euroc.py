"""EuRoC MAV: `mav0/cam0/data.csv` lists images with their stamps, `mav0/state_groundtruth_estimate0/data.csv` is truth.

Burri, Nikolic, Gohl, Schneider, Rehder, Omari, Achtelik and Siegwart, "The EuRoC micro aerial vehicle datasets", IJRR
2016. A row of the list is `timestamp [ns],filename`, the file in `mav0/cam0/data/`. `mav0/cam0/sensor.yaml` states the
left camera: intrinsics, distortion, and its pose T_BS in the body; `cam1` and more beside it are alike. True poses are
of the body, in whose frame their own `sensor.yaml`, where there is one, places what they are of; they are interpolated
to the images' stamps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from filtering.errors import quoted
from filtering.se3 import Poses
from sequences.datasets.layout import Layout, PosedImages
from sequences.datasets.layout_helpers.image_files import camera_of, lens_of, scaled_to
from sequences.datasets.layout_helpers.packed import ImageFile
from sequences.datasets.layout_helpers.pose_lists import list_stamped
from sequences.datasets.layout_helpers.pose_rows import read_pose_matrix
from sequences.errors import SequenceError
from sequences.files import Rows, read_yaml
from sequences.frame import Camera, Trajectory
from sequences.images.undistortion import DistortionModel, Lens
from sequences.trajectories.pose_tables import read_pose_table
from sequences.values import MAX_TIME_NS, parse_numbers, parse_whole

_NAME = "EuRoC MAV"
_MODELS: dict[str, DistortionModel] = {
    "radial-tangential": "plumb_bob",
    "radtan": "plumb_bob",
    "plumb_bob": "plumb_bob",
    "equidistant": "equidistant",
}
_PINHOLE = ("none", *(name for name, model in _MODELS.items() if model == "plumb_bob"))  # where coefficients are 0
_MAX_YAML = 1 << 16  # bytes


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
    truth_file = folder / "state_groundtruth_estimate0" / "data.csv"
    if not truth_file.is_file():
        raise SequenceError(f"{truth_file}: no such file, expected the true poses of the sequence")
    truth_rows = Rows("true poses")
    truth = read_pose_table(truth_file, rows=truth_rows)
    stated = truth_file.with_name("sensor.yaml")
    sensor_from_body = _body_from_sensor(stated).inverse() if stated.is_file() else Poses.identity()
    images, body_from_camera = _of_camera(folder / "cam0", truth, sensor_from_body)
    others = {}
    for beside in sorted(folder.glob("cam[1-9]")):
        if (beside / "data.csv").is_file() and (beside / "sensor.yaml").is_file():
            more, body_from_other = _of_camera(beside, truth, sensor_from_body)
            others[beside.name] = more, body_from_camera.inverse() @ body_from_other
    return replace(images, notices=[*truth_rows.notices, *images.notices], others=others)


def _of_camera(folder: Path, truth: Trajectory, sensor_from_body: Poses) -> tuple[PosedImages, Poses]:
    """Images of one camera, and its pose in the body."""
    calibration = folder / "sensor.yaml"
    body_from_camera = _body_from_sensor(calibration)
    images = list_stamped(_NAME, folder, folder / "data.csv", folder / "data", _time_and_name, truth)
    world_from_camera = images.world_from_camera @ (sensor_from_body @ body_from_camera)
    camera = _read_camera(calibration, images.files)
    return replace(images.with_camera(camera), world_from_camera=world_from_camera), body_from_camera


def _time_and_name(line: str, where: str) -> tuple[int, str]:
    fields = [field.strip() for field in line.split(",")]
    if len(fields) != 2 or not fields[1]:
        raise SequenceError(f"{where}: {quoted(line)}, expected `timestamp [ns],filename`")
    return parse_whole(fields[0], f"{where}: nanoseconds", -MAX_TIME_NS, MAX_TIME_NS), fields[1]


def _body_from_sensor(file: Path) -> Poses:
    content = read_yaml(file, _MAX_YAML).get("T_BS")
    values = content.get("data") if isinstance(content, dict) else content
    if not isinstance(values, list):
        raise SequenceError(f"{file}: T_BS is {quoted(content)}, expected its data: 16 numbers")
    rows = [values[i : i + 4] for i in range(0, len(values), 4)] if len(values) == 16 else values
    pose = read_pose_matrix(rows, f"{file}: T_BS")
    if isinstance(pose, str):
        raise SequenceError(f"{file}: T_BS is not finite, expected the pose of the sensor in the body")
    return pose


def _read_camera(file: Path, files: Sequence[ImageFile]) -> Camera | Lens:
    content = read_yaml(file, _MAX_YAML)
    if content.get("camera_model", "pinhole") != "pinhole":
        raise SequenceError(f"{file}: camera_model {quoted(content['camera_model'])}, expected pinhole")
    found: dict[str, list[float]] = {}
    for name, counts in (("resolution", (2,)), ("intrinsics", (4,)), ("distortion_coefficients", (0, 4, 5))):
        values = content.get(name) or []
        found[name] = parse_numbers(values, f"{file}: {name}") if isinstance(values, list) else []
        if len(found[name]) not in counts:
            raise SequenceError(f"{file}: {name} is {quoted(values)}, expected {counts[-1]} numbers")
    camera = camera_of(str(file), found["resolution"], found["intrinsics"][:2], found["intrinsics"][2:])
    coefficients = found["distortion_coefficients"]
    model = content.get("distortion_model")
    if not coefficients or (model in _PINHOLE and not any(coefficients)):
        return scaled_to(camera, files)
    if model not in _MODELS:
        raise SequenceError(f"{file}: distortion_model {quoted(model)}, expected one of {', '.join(_MODELS)}")
    return scaled_to(lens_of(str(file), camera, _MODELS[model], coefficients), files)


LAYOUT = Layout(_NAME, looked_for="mav0/cam0/data.csv", order=20, list_images=list_images)
