"""Data sets as phones, drones and reconstructions leave them, of dots that tell one convention from another."""

import json
import struct
import zipfile
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from filtering.se3 import Poses
from tests.helpers import dot_scene
from tests.helpers.dot_scene import CX, CY, FX, FY, HEIGHT, WIDTH, drawn, opencv, opencv_pixels, opengl

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
        dot_scene.write(mav / "cam0" / "data" / f"{time_ns}.png", drawn(opencv(i), pixels))
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
            dot_scene.write(folder / "rgb" / f"{i:06d}.jpg", image)
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
    """What the app writes of a recording: poses with OpenGL's axes, K column by column."""
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
    images = [drawn(opengl(i), dot_scene.opengl_pixels) for i in range(NUM)]
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
        image = drawn(opengl(i), dot_scene.opengl_pixels, half=half)
        dot_scene.write(folder / "images" / f"frame_{i + 8:d}.png", image)
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
            dot_scene.write(root / "images" / "küche" / f"{i + 8} b.png", drawn(opencv(i), opencv_pixels, half=0.5))
    (model / "points3D.bin").write_bytes(struct.pack("<Q", 0))
    return root
