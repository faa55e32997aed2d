"""Recordings of Foxglove's messages: one description of each message, written as protobuf, as JSON or by ROS 2."""

import base64
import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import IO, Any, NamedTuple

import mcap_ros2.writer
from foxglove import messages
from mcap.writer import Writer

from filtering.se3 import Poses
from sequences.recordings.message_definitions import schema_name, schema_text
from tests.helpers.sequence_files import BASE_FROM_CAMERA, BEGIN_NS, CAMERA, Walk
from tests.helpers.tf_files import MAP_FROM_ODOM, MS, body, stamps

ENCODINGS = ["protobuf", "json", "cdr"]

_NESTED = {
    **dict.fromkeys(("position", "translation"), messages.Vector3),
    **dict.fromkeys(("orientation", "rotation"), messages.Quaternion),
    **dict.fromkeys(("pose", "poses"), messages.Pose),
    "transforms": messages.FrameTransform,
}


class Told(NamedTuple):
    """One message, logged at `time_ns`. Stamps are whole nanoseconds, data are bytes."""

    time_ns: int
    topic: str
    name: str
    fields: dict[str, Any]


def write(path: Path, encoding: str, *parts: Iterable[Told]) -> Path:
    events = sorted((event for part in parts for event in part), key=lambda event: event.time_ns)
    with open(path, "wb") as file:
        if encoding == "cdr":
            _write_cdr(file, events)
            return path
        writer, channels = Writer(file), {}
        writer.start()
        for e in events:
            kind = getattr(messages, e.name)
            if (e.topic, e.name) not in channels:
                by_json = "jsonschema", b'{"type": "object"}'
                described = by_json if encoding == "json" else ("protobuf", kind.get_schema().data)
                schema = writer.register_schema(f"foxglove.{e.name}", *described)
                channels[e.topic, e.name] = writer.register_channel(e.topic, encoding, schema)
            if encoding == "json":
                data = json.dumps(_with_times(e.fields, "nsec", as_text)).encode()
            else:
                data = _as_message(kind, e.fields).encode()
            writer.add_message(channels[e.topic, e.name], e.time_ns, data, e.time_ns)
        writer.finish()
    return path


def _write_cdr(file: IO[bytes], events: list[Told]) -> None:
    with mcap_ros2.writer.Writer(file) as writer:
        schemas: dict[str, Any] = {}
        for e in events:
            ros = f"foxglove_msgs/{e.name}"
            if ros not in schemas:
                schemas[ros] = writer.register_msgdef(schema_name(ros), schema_text(ros))
            fields = {name.lower() if name in "DKRP" else name: v for name, v in e.fields.items()}
            writer.write_message(e.topic, schemas[ros], _with_times(fields, "nanosec", bytes), e.time_ns)


def as_text(data: bytes) -> str:
    return base64.b64encode(data).decode()


def _with_times(value: Any, nanoseconds: str, encode: Callable[[bytes], Any]) -> Any:
    if isinstance(value, dict):
        return {
            name: {"sec": v // 10**9, nanoseconds: v % 10**9}
            if name == "timestamp"
            else _with_times(v, nanoseconds, encode)
            for name, v in value.items()
        }
    if isinstance(value, list):
        return [_with_times(v, nanoseconds, encode) for v in value]
    return encode(value) if isinstance(value, bytes) else value


def _as_message(kind: Any, fields: dict[str, Any]) -> Any:
    """A message of Foxglove's own library."""

    def converted(name: str, value: Any) -> Any:
        if name == "timestamp":
            return messages.Timestamp(*divmod(value, 10**9))
        if name in _NESTED and isinstance(value, list):
            return [_as_message(_NESTED[name], each) for each in value]
        return _as_message(_NESTED[name], value) if name in _NESTED else value

    return kind(**{name: converted(name, value) for name, value in fields.items()})


# --- the walk of `sequence_files`, in Foxglove's messages ----------------------------------


def vector(p: Poses) -> dict[str, float]:
    return dict(zip("xyz", p.translation.tolist(), strict=True))


def quaternion(p: Poses) -> dict[str, float]:
    return dict(zip("xyzw", p.as_quat_xyzw().tolist(), strict=True))


def pose(p: Poses) -> dict[str, Any]:
    return {"position": vector(p), "orientation": quaternion(p)}


def images(num_images: int = 12, topic: str = "/camera/image") -> list[Told]:
    return [
        Told(t, topic, "CompressedImage", {"timestamp": t, "frame_id": "camera", "data": data, "format": "png"})
        for t, data in Walk(num_images).images
    ]


def calibration(topic: str = "/camera/calibration", **changes: Any) -> list[Told]:
    c = CAMERA
    fields = {
        "timestamp": BEGIN_NS,
        "frame_id": "camera",
        "width": c.width,
        "height": c.height,
        "distortion_model": "plumb_bob",
        "D": [0.0] * 5,
        "K": [c.fx, 0.0, c.cx, 0.0, c.fy, c.cy, 0.0, 0.0, 1.0],
        "R": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        "P": [c.fx, 0.0, c.cx, 0.0, 0.0, c.fy, c.cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    }
    return [Told(BEGIN_NS, topic, "CameraCalibration", {**fields, **changes})]


def camera_poses(num_images: int = 12) -> list[Told]:
    return [
        Told(t, "/pose", "PoseInFrame", {"timestamp": t, "frame_id": "map", "pose": pose(p)})
        for t, p in Walk(num_images).truth
    ]


def transforms(
    parent: str, child: str, times_ns: Iterable[int], at: Callable[[int], Poses], *, topic: str = "/transforms"
) -> list[Told]:
    """Links, each as a message of its own, or wrapped where the topic ends in an s."""
    links = []
    for t in times_ns:
        link = {"timestamp": t, "parent_frame_id": parent, "child_frame_id": child}
        link |= {"translation": vector(at(t)), "rotation": quaternion(at(t))}
        wrapped = topic.endswith("s")
        links.append(Told(t, topic, f"FrameTransform{'s' * wrapped}", {"transforms": [link]} if wrapped else link))
    return links


def robot(topic: str = "/transforms") -> list[Told]:
    """map -> odom that never changes, odom -> base_link at 50 Hz, base_link -> camera once."""
    return [
        *transforms("map", "odom", stamps(every_ms=90, since_ms=-39), lambda _: MAP_FROM_ODOM, topic=topic),
        *transforms("odom", "base_link", stamps(), lambda t: MAP_FROM_ODOM.inverse() @ body(t), topic=topic),
        *transforms("base_link", "camera", [BEGIN_NS - 40 * MS], lambda _: BASE_FROM_CAMERA, topic=topic),
    ]
