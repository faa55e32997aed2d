"""Recordings of the walk of `sequence_files` by a robot, with poses in tf, odometry, a path or elsewhere."""

from collections.abc import Callable, Iterable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from mcap_ros2.writer import Writer

from filtering.se3 import Poses
from sequences.datasets.frames import posed_frames
from sequences.frame import Camera, Frame
from sequences.options import SequenceOptions
from sequences.recordings.message_definitions import schema_name, schema_text
from tests.helpers.sequence_files import BASE_FROM_CAMERA, BEGIN_NS, Walk, world_from_base

MS = 1_000_000
MESSAGE_TYPES = (
    *("std_msgs/Empty", "rosgraph_msgs/Clock", "diagnostic_msgs/DiagnosticArray", "tf2_msgs/TFMessage"),
    *("geometry_msgs/PoseStamped", "geometry_msgs/PoseWithCovarianceStamped", "geometry_msgs/PoseArray"),
    *("geometry_msgs/TransformStamped", "nav_msgs/Path", "nav_msgs/Odometry", "visualization_msgs/MarkerArray"),
    *("sensor_msgs/CompressedImage", "sensor_msgs/Image", "sensor_msgs/CameraInfo"),
    *("ffmpeg_image_transport_msgs/FFMPEGPacket", "foxglove_msgs/CameraCalibration", "foxglove_msgs/FrameTransforms"),
)
"""Types that are read or written."""
MAP_FROM_ODOM = Poses.exp(np.array([5.0, -3.0, 0.2, 0.0, 0.0, 0.8]))


class Event(NamedTuple):
    """One message of a recording, logged at `time_ns`."""

    time_ns: int
    topic: str
    type: str
    message: dict[str, Any]


def record(path: Path, *parts: Iterable[Event]) -> Path:
    return write_events(path, sorted((event for part in parts for event in part), key=lambda event: event.time_ns))


def write_events(path: Path, events: Iterable[Event]) -> Path:
    with open(path, "wb") as file, Writer(file, chunk_size=20_000) as writer:
        schemas: dict[str, Any] = {}
        for event in events:
            if event.type not in schemas:
                schemas[event.type] = writer.register_msgdef(schema_name(event.type), schema_text(event.type))
            writer.write_message(event.topic, schemas[event.type], event.message, log_time=event.time_ns)
    return path


def stamps(num_images: int = 12, *, every_ms: int = 20, since_ms: int = -33) -> list[int]:
    """Times from before the first image to after the last, off the images' stamps."""
    return list(range(BEGIN_NS + since_ms * MS, BEGIN_NS + (100 * num_images + 60) * MS, every_ms * MS))


def header(time_ns: int, frame: str) -> dict[str, Any]:
    return {"stamp": {"sec": time_ns // 10**9, "nanosec": time_ns % 10**9}, "frame_id": frame}


def pose(p: Poses) -> dict[str, Any]:
    x, y, z, w = p.as_quat_xyzw().tolist()
    px, py, pz = p.translation.tolist()
    return {"position": {"x": px, "y": py, "z": pz}, "orientation": {"x": x, "y": y, "z": z, "w": w}}


def transform(time_ns: int, parent: str, child: str, p: Poses) -> dict[str, Any]:
    parts = pose(p)
    moved = {"translation": parts["position"], "rotation": parts["orientation"]}
    return {"header": header(time_ns, parent), "child_frame_id": child, "transform": moved}


def images(num_images: int = 12, frame: str = "camera") -> list[Event]:
    return [
        Event(t, "/image/compressed", "sensor_msgs/CompressedImage", {"header": header(t, frame), "data": data})
        for t, data in Walk(num_images).images
    ]


def camera_infos(cameras: Iterable[tuple[int, Camera]], topic: str = "/image/camera_info") -> list[Event]:
    events = []
    for t, c in cameras:
        k = [c.fx, 0.0, c.cx, 0.0, c.fy, c.cy, 0.0, 0.0, 1.0]
        p = [c.fx, 0.0, c.cx, 0.0, 0.0, c.fy, c.cy, 0.0, 0.0, 0.0, 1.0, 0.0]
        message = {"header": header(t, "camera"), "width": c.width, "height": c.height, "k": k, "p": p}
        message |= {"r": np.eye(3).ravel().tolist(), "distortion_model": "plumb_bob", "d": [0.0] * 5}
        events.append(Event(t, topic, "sensor_msgs/CameraInfo", message))
    return events


def tf(parent: str, child: str, times_ns: Iterable[int], at: Callable[[int], Poses], topic: str = "/tf") -> list[Event]:
    return [
        Event(t, topic, "tf2_msgs/TFMessage", {"transforms": [transform(t, parent, child, at(t))]}) for t in times_ns
    ]


def mounted(base: str = "base_link", camera: str = "camera", topic: str = "/tf_static") -> list[Event]:
    return tf(base, camera, [BEGIN_NS - 40 * MS], lambda _: BASE_FROM_CAMERA, topic)


def body(time_ns: int) -> Poses:
    return world_from_base(np.array(time_ns))


def odometry(times_ns: Iterable[int]) -> list[Event]:
    parts = [(t, {"header": header(t, "odom"), "pose": {"pose": pose(body(t))}}) for t in times_ns]
    return [Event(t, "/odom", "nav_msgs/Odometry", {**part, "child_frame_id": "base_link"}) for t, part in parts]


def told_by(message_type: str, times_ns: Iterable[int], topic: str = "/truth", child: str = "base_link") -> list[Event]:
    """The robot's poses in the map, as messages of one type; of nav_msgs/Path each message adds one."""
    events = []
    for t in times_ns:
        stamped = {"header": header(t, "map"), "pose": pose(body(t))}
        message = {
            "geometry_msgs/PoseStamped": stamped,
            "geometry_msgs/PoseWithCovarianceStamped": {**stamped, "pose": {"pose": pose(body(t))}},
            "geometry_msgs/TransformStamped": transform(t, "map", child, body(t)),
            "nav_msgs/Odometry": {**stamped, "child_frame_id": child, "pose": {"pose": pose(body(t))}},
            "nav_msgs/Path": {"header": header(t, "map"), "poses": [stamped]},
        }[message_type]
        events.append(Event(t, topic, message_type, message))
    return events


def robot(path: Path, *, jump_ns: int | None = None, extra: list[Event] | None = None) -> Path:
    """map -> odom every 90 ms, which may jump by 0.6 m, odom -> base_link at 50 Hz, base_link -> camera fixed."""

    def map_from_odom(t: int) -> Poses:
        shift = np.array([0.6, 0.0, 0.0]) if jump_ns is not None and t >= jump_ns else np.zeros(3)
        return Poses(MAP_FROM_ODOM.rotation, MAP_FROM_ODOM.translation + shift)

    return record(
        path,
        images(),
        mounted(),
        tf("map", "odom", stamps(every_ms=90, since_ms=-39), map_from_odom),
        tf("odom", "base_link", stamps(), lambda t: MAP_FROM_ODOM.inverse() @ body(t)),
        extra or [],
    )


TYPES = ["nav_msgs/Odometry", "geometry_msgs/TransformStamped"]

TYPES_OF_UNSAID = ["geometry_msgs/PoseStamped", "geometry_msgs/PoseWithCovarianceStamped", "nav_msgs/Path"]


def require_true(frames: list[Frame], tolerance_m: float = 1e-3) -> None:
    """All twelve frames have the walk's true pose: interpolated over 20 ms, which costs half a millimetre at most."""
    assert len(frames) == 12
    for frame in frames:
        assert frame.world_from_camera is not None
        expected = body(frame.time_ns) @ BASE_FROM_CAMERA
        metres, radians = frame.world_from_camera.distance(expected)
        assert metres < tolerance_m
        assert radians < 1e-3


def read(path: Path, **options: object) -> list[Frame]:
    return list(posed_frames(path, options=SequenceOptions(**options)))  # pyright: ignore[reportArgumentType]


def image_message(pixels: np.ndarray, encoding: str, *, padding: int = 0, big_endian: bool = False) -> SimpleNamespace:
    """A sensor_msgs/Image whose rows end in `padding` bytes of rubbish."""
    rows = pixels.astype(pixels.dtype.newbyteorder(">" if big_endian else "<"), copy=False)
    rows = np.frombuffer(np.ascontiguousarray(rows).tobytes(), np.uint8).reshape(len(pixels), -1)
    rows = np.concatenate([rows, np.full((len(rows), padding), 123, np.uint8)], axis=1)
    return SimpleNamespace(
        height=pixels.shape[0],
        width=pixels.shape[1],
        encoding=encoding,
        is_bigendian=int(big_endian),
        step=rows.shape[1],
        data=rows.tobytes(),
    )


_BELOW = {"bool": 2, "byte": 100, "uint8": 200, "int32": 2**31, "uint32": 2**32, "uint64": 2**63}


def made_up(message_type: str, rng: np.random.Generator) -> dict[str, Any]:
    """A message of a type, with texts of up to ten bytes and lists of up to three."""

    def one(kind: str) -> Any:
        if "/" in kind:
            return made_up(kind, rng)
        if kind == "string":
            return "ü" * int(rng.integers(2)) + "x" * int(rng.integers(9))
        return int(rng.integers(_BELOW[kind])) if kind in _BELOW else float(np.float32(rng.normal()))

    message: dict[str, Any] = {}
    lines = schema_text(message_type).split("=" * 80)[0].splitlines()
    for kind, name in (line.split() for line in lines if "=" not in line):  # constants have one
        base, _, length = kind.removesuffix("]").partition("[")
        many = [one(base) for _ in range(int(length or rng.integers(4)))]
        message[name] = one(base) if base == kind else bytes(many) if base == "uint8" else many
    return message
