"""Coloured dots in space, drawn by a format's documented conventions, to check its reader.

`drawn` knows a pose only by the words of a format ("the axes are x right, y up, z backward"), and `misses` only what
was read, by OpenCV's projection. So a dot is where it is expected only if axes, direction and intrinsics were all
understood."""

import json
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from filtering.se3 import Poses
from sequences.datasets.convert import convert
from sequences.datasets.frames import posed_frames
from sequences.datasets.layout import PosedImages
from sequences.datasets.listing import list_images
from sequences.errors import SequenceError
from sequences.frame import Frame

WIDTH, HEIGHT = 160, 120
FX, FY, CX, CY = 110.0, 104.0, 83.0, 57.0
COLOURS = np.array([[255, 0, 0], [0, 255, 0], [0, 0, 255], [255, 255, 0], [255, 0, 255], [0, 255, 255]], np.uint8)
DOTS = np.array(
    [[0.7, 4.1, 0.3], [-0.6, 4.6, 0.7], [0.1, 5.9, -0.5], [-0.7, 5.2, -0.6], [0.5, 6.6, 0.9], [0.9, 5.4, -0.3]]
)
"""In a world where the cameras of `looking` stand near zero and look along y."""

Pixels = Callable[[np.ndarray], np.ndarray]


def looking(index: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A camera's right, down and ahead in the world, and its place: never aligned with anything."""
    ahead = np.array([0.07 - 0.05 * index, 1.0, 0.04 * index - 0.06])
    ahead /= np.linalg.norm(ahead)
    right = np.cross(ahead, [0.12, 0.1, 1.0])
    right /= np.linalg.norm(right)
    return right, np.cross(ahead, right), ahead, np.array([0.1 * index - 0.2, 0.15 * index, 0.1 - 0.03 * index])


def opengl(index: int) -> np.ndarray:
    """Camera-to-world by its words in OpenGL: x right, y up, z backward; (4, 4)."""
    right, down, ahead, centre = looking(index)
    return np.block([[np.column_stack([right, -down, -ahead]), centre[:, None]], [np.zeros((1, 3)), np.ones((1, 1))]])


def opencv(index: int) -> np.ndarray:
    """Camera-to-world by its words in OpenCV: x right, y down, z forward; (4, 4)."""
    right, down, ahead, centre = looking(index)
    return np.block([[np.column_stack([right, down, ahead]), centre[:, None]], [np.zeros((1, 3)), np.ones((1, 1))]])


def opengl_pixels(camera_points: np.ndarray) -> np.ndarray:
    """OpenGL's projection, into pixels whose rows count downwards."""
    x, y, depth = camera_points[:, 0], camera_points[:, 1], -camera_points[:, 2]
    return np.column_stack([CX + FX * x / depth, CY - FY * y / depth])


def opencv_pixels(camera_points: np.ndarray) -> np.ndarray:
    x, y, depth = camera_points.T
    return np.column_stack([CX + FX * x / depth, CY + FY * y / depth])


def drawn(camera_to_world: np.ndarray, pixels: Pixels, *, half: float = 0.0) -> np.ndarray:
    """The dots as a camera sees them, BGR; `half` is where the first pixel's centre lies."""
    image = np.full((HEIGHT, WIDTH, 3), 90, np.uint8)
    points = (DOTS - camera_to_world[:3, 3]) @ camera_to_world[:3, :3]
    for point, pixel, colour in zip(points, pixels(points) - half, COLOURS, strict=True):
        assert point is not None
        assert 8 < pixel[0] < WIDTH - 8
        assert 8 < pixel[1] < HEIGHT - 8
        centre = np.rint(pixel * 16).astype(int).tolist()
        cv2.circle(image, centre, 5 * 16, colour[::-1].tolist(), -1, cv2.LINE_AA, shift=4)
    return image


def write(file: Path, image: np.ndarray) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    options = [cv2.IMWRITE_JPEG_QUALITY, 98] if file.suffix == ".jpg" else []
    assert cv2.imwrite(str(file), image, options)


def misses(frame: Frame, *, dots: np.ndarray = DOTS) -> np.ndarray:
    """How many pixels each dot of a frame is from where its pose and camera put it."""
    assert frame.world_from_camera is not None
    assert frame.camera is not None
    points = frame.world_from_camera.inverse().apply(dots)
    if (points[:, 2] <= 0).any():
        return np.full(len(dots), np.inf)  # behind the camera
    camera = frame.camera
    assert frame.image.shape == (camera.height, camera.width, 3)
    expected = np.column_stack(
        [camera.cx + camera.fx * points[:, 0] / points[:, 2], camera.cy + camera.fy * points[:, 1] / points[:, 2]]
    )
    found = []
    for colour in COLOURS:
        rows, columns = np.nonzero(np.abs(frame.image.astype(int) - colour).max(axis=2) < 100)
        assert len(rows) > 20, f"no dot of colour {colour}"
        found.append([columns.mean(), rows.mean()])
    return np.linalg.norm(np.array(found) - expected, axis=1)


def true_pose(index: int) -> Poses:
    return Poses.from_matrix(opencv(index))


BEGIN_NS = 1_403_636_579_763_555_584
NUM = 5
T_BS = [
    *(0.0148655429818, -0.999880929698, 0.00414029679422, -0.0216401454975),
    *(0.999557249008, 0.0149672133247, 0.025715529948, -0.064676986768),
    *(-0.0257744366974, 0.00375618835797, 0.999660727178, 0.00981073058949),
    *(0.0, 0.0, 0.0, 1.0),
]
EUROC_DISTORTION = [-0.9, 0.5, 0.01, -0.015]  # more than of the published lens: the dots are in the middle
GT_HEADER = "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], v_RS_R_x"


def sensor_yaml(distortion: list[float], model: str = "radial-tangential") -> str:
    rows = ",\n         ".join(", ".join(map(str, T_BS[i : i + 4])) for i in range(0, 16, 4))
    return (
        "# General sensor definitions.\nsensor_type: camera\ncomment: VI-Sensor cam0 (MT9M034)\n\n"
        f"T_BS:\n  cols: 4\n  rows: 4\n  data: [{rows}]\n\nrate_hz: 20\nresolution: [{WIDTH}, {HEIGHT}]\n"
        f"camera_model: pinhole\nintrinsics: [{FX}, {FY}, {CX}, {CY}] #fu, fv, cu, cv\n"
        f"distortion_model: {model}\ndistortion_coefficients: {distortion}\n"
    )


def distorted_pixels(camera_points: np.ndarray) -> np.ndarray:
    """The radial-tangential model written out: its terms are k1 k2 p1 p2."""
    k1, k2, p1, p2 = EUROC_DISTORTION
    x, y = (camera_points[:, :2] / camera_points[:, 2:]).T
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2
    return np.column_stack(
        [
            CX + FX * (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)),
            CY + FY * (y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y),
        ]
    )


def make_euroc(folder: Path, *, distorted: bool = False) -> Path:
    """Images at 20 Hz; truth of the body at 200 Hz, off the images' stamps, turning evenly from image to image."""
    mav = folder / "mav0"
    body_from_camera = np.array(T_BS).reshape(4, 4)
    truth = mav / "state_groundtruth_estimate0"
    truth.mkdir(parents=True)
    lines = ["#timestamp [ns],filename"]
    for i in range(NUM):
        time_ns = BEGIN_NS + i * 50_000_000
        pixels = distorted_pixels if distorted else opencv_pixels
        write(mav / "cam0" / "data" / f"{time_ns}.png", drawn(opencv(i), pixels))
        lines.append(f"{time_ns},{time_ns}.png")
    (mav / "cam0" / "data.csv").write_text("\r\n".join(lines) + "\r\n")
    (mav / "cam0" / "sensor.yaml").write_text(sensor_yaml(EUROC_DISTORTION if distorted else [0.0] * 4))
    rows = [GT_HEADER]
    for i in range(NUM - 1):
        one, other = opencv(i) @ np.linalg.inv(body_from_camera), opencv(i + 1) @ np.linalg.inv(body_from_camera)
        start, end = Poses.from_matrix(one), Poses.from_matrix(other)
        for step in range(0, 50, 5):
            pose = start.interpolate(end, step / 50)
            x, y, z, w = pose.as_quat_xyzw()
            values = [*pose.translation, w, x, y, z, 0.1, 0.2, 0.3, 0, 0, 0, 0, 0, 0]
            rows.append(f"{BEGIN_NS + i * 50_000_000 + step * 1_000_000}," + ",".join(f"{v:.9f}" for v in values))
    (truth / "data.csv").write_text("\n".join(rows) + "\n")
    (truth / "sensor.yaml").write_text(
        "sensor_type: visual-inertial\nT_BS:\n  cols: 4\n  rows: 4\n"
        "  data: [1.0, 0, 0, 0,\n 0, 1.0, 0, 0,\n 0, 0, 1.0, 0,\n 0, 0, 0, 1.0]\n"
    )
    return folder


STRAY_TIMES = [25_841_123_456_789 + i * 16_666_667 for i in range(NUM)]


def make_stray(folder: Path, *, video: bool = True, extra: int = 0) -> Path:
    """A recording; the app's own axes are OpenCV's. Poses are camera-to-world, seconds since the phone was started."""
    folder.mkdir(parents=True)
    images = [drawn(opencv(i), opencv_pixels) for i in range(NUM)]
    images += images[-1:] * extra
    if video:
        codec = cv2.VideoWriter.fourcc(*"mp4v")
        writer = cv2.VideoWriter(str(folder / "rgb.mp4"), codec, 60, (WIDTH, HEIGHT))
        for image in images:
            writer.write(image)
        writer.release()
    else:
        for i, image in enumerate(images):
            write(folder / "rgb" / f"{i:06d}.jpg", image)
    np.savetxt(folder / "camera_matrix.csv", [[FX, 0, CX], [0, FY, CY], [0, 0, 1]], delimiter=", ", fmt="%.6f")
    rows = ["timestamp, frame, x, y, z, qx, qy, qz, qw"]
    for i, time_ns in enumerate(STRAY_TIMES):
        pose = opencv(i)
        values = [*pose[:3, 3], *Rotation.from_matrix(pose[:3, :3]).as_quat()]
        stamp = f"{time_ns // 10**9}.{time_ns % 10**9:09d}"
        rows.append(f"{stamp}, {i:06d}, " + ", ".join(f"{v:.8f}" for v in values))
    (folder / "odometry.csv").write_text("\n".join(rows))
    return folder


R3D_SECONDS = [0.5 + i / 60 for i in range(NUM)]


def r3d_metadata() -> dict:
    poses = [[*Rotation.from_matrix(opengl(i)[:3, :3]).as_quat(), *opengl(i)[:3, 3]] for i in range(NUM)]
    return {
        "fps": 60,
        "w": WIDTH,
        "h": HEIGHT,
        "initPose": [0, 0, 0, 1, 0, 0, 0],
        "K": [FX, 0, 0, 0, FY, 0, CX, CY, 1],
        "poses": poses,
        "frameTimestamps": list(R3D_SECONDS),
        "perFrameIntrinsicCoeffs": [[FX + i - 2, FY, CX, CY] for i in range(NUM)],
    }


def r3d_images() -> list[bytes]:
    images = [drawn(opengl(i), opengl_pixels) for i in range(NUM)]
    return [cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 98])[1].tobytes() for image in images]


def make_r3d(file: Path, metadata: dict) -> Path:
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("metadata", json.dumps(metadata))
        archive.writestr("sound.m4a", b"")
        for i, data in enumerate(r3d_images()):
            archive.writestr(f"rgbd/{i}.jpg", data)
            archive.writestr(f"rgbd/{i}.depth", b"no")
    return file


def make_record3d_export(folder: Path, metadata: dict) -> Path:
    (folder / "rgb").mkdir(parents=True)
    (folder / "metadata.json").write_text(json.dumps(metadata))
    for i, data in enumerate(r3d_images()):
        (folder / "rgb" / f"{i}.jpg").write_bytes(data)
    return folder


def make_nerfstudio(folder: Path, *, half: float = 0.5) -> Path:
    """A folder as `ns-process-data` leaves it: frames out of order, pixels' centres at half-integers."""
    frames = []
    for i in (3, 0, 2, 1, 4):
        image = drawn(opengl(i), opengl_pixels, half=half)
        write(folder / "images" / f"frame_{i + 8:d}.png", image)
        frames.append({"file_path": f"images/frame_{i + 8:d}.png", "transform_matrix": opengl(i).tolist()})
    intrinsics = {"w": WIDTH, "h": HEIGHT, "fl_x": FX, "fl_y": FY, "cx": CX, "cy": CY, "k1": 0.0, "k2": 0.0}
    content = {
        "camera_model": "OPENCV",
        "applied_transform": [[1.0, 0, 0, 0], [0, 1.0, 0, 0], [0, 0, 1.0, 0]],
        "frames": frames,
    } | intrinsics
    (folder / "transforms.json").write_text(json.dumps(content))
    return folder


def make_colmap_binary(root: Path) -> Path:
    """Two cameras and keypoints, as its documents lay them out: little endian, ids of any order."""
    model = root / "sparse" / "0"
    model.mkdir(parents=True)
    with open(model / "cameras.bin", "wb") as stream:
        stream.write(struct.pack("<Q", 2))
        stream.write(struct.pack("<iiQQ", 7, 4, WIDTH, HEIGHT) + struct.pack("<8d", FX, FY, CX, CY, 0, 0, 0, 0))
        stream.write(struct.pack("<iiQQ", 2, 1, WIDTH, HEIGHT) + struct.pack("<4d", FX, FY, CX, CY))
    with open(model / "images.bin", "wb") as stream:
        stream.write(struct.pack("<Q", NUM))
        for i in (4, 1, 0, 3, 2):
            world_to_camera = np.linalg.inv(opencv(i))
            x, y, z, w = Rotation.from_matrix(world_to_camera[:3, :3]).as_quat()
            stream.write(struct.pack("<i", 90 - i) + struct.pack("<7d", w, x, y, z, *world_to_camera[:3, 3]))
            stream.write(struct.pack("<i", 7 if i else 2) + f"küche/{i + 8} b.png".encode() + b"\0")
            stream.write(struct.pack("<Q", i))
            for k in range(i):
                stream.write(struct.pack("<ddq", 1.5 * k, 2.5, -1 if k else 12))
            write(root / "images" / "küche" / f"{i + 8} b.png", drawn(opencv(i), opencv_pixels, half=0.5))
    (model / "points3D.bin").write_bytes(struct.pack("<Q", 0))
    return root


def check(path: Path, indices: list[int], times_ns: list[int] | None, *, within_px: float = 0.7) -> list[Frame]:
    """Every dot is where the pose and the camera that were read put it, in all images, and these are of their times."""
    frames = list(posed_frames(path))
    assert len(indices) == len(frames)
    for index, frame in zip(indices, frames, strict=True):
        metres, radians = frame.world_from_camera.distance(true_pose(index))
        assert metres < 1e-5
        assert radians < 1e-5
        assert misses(frame).max() < within_px
    if times_ns is not None:
        assert [frame.time_ns for frame in frames] == times_ns
    return frames


def check_conversion(path: Path, folder: Path, indices: list[int], *, within_px: float = 0.7) -> None:
    """What `convert` writes is read back as the same images, poses and times."""
    assert convert(path, folder / "out.mcap").num_images == len(indices)
    check(folder / "out.mcap", indices, [frame.time_ns for frame in posed_frames(path)], within_px=within_px)


def refuse(path: Path, *said: str) -> None:
    """Reading fails with one line that contains all of `said`."""
    with pytest.raises(SequenceError) as error:
        list_images(path)
    line = str(error.value)
    assert "\n" not in line
    for words in said:
        assert words in line, line


def leaves_out(path: Path, num_rows: int, *said: str) -> PosedImages:
    """Reading skips and counts one row; one notice contains all of `said`."""
    listed = list_images(path)
    (notice,) = listed.notices
    assert notice.startswith(f"1 of {num_rows} ")
    for words in said:
        assert words in notice, notice
    return listed


def edit(file: Path, change: Callable[[str], str]) -> None:
    before = file.read_text()
    after = change(before)
    assert after != before
    file.write_text(after)


def edit_json(file: Path, change: Callable[[dict], object]) -> None:
    content = json.loads(file.read_text())
    change(content)
    file.write_text(json.dumps(content))


THIRTIETHS = [i * 1_000_000_000 // 30 for i in range(NUM)]
