"""Recordings of Foxglove's messages: one description of each message, written as protobuf, as JSON or by ROS 2."""

import base64
import json
from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import mcap_protobuf.writer
import mcap_ros2.writer
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2
from mcap.writer import Writer

from filtering.se3 import Poses
from sequences.recordings.message_definitions import schema_name, schema_text
from tests.helpers.sequence_files import BASE_FROM_CAMERA, BEGIN_NS, CAMERA, Walk
from tests.helpers.tf_files import MAP_FROM_ODOM, MS, body, stamps

ENCODINGS = ["protobuf", "json", "cdr"]

_NUMBERS = dict.fromkeys("xyz", "double")
# Fields and their types as of Foxglove's .proto files; `[]` marks a list.
_PROTO = {
    "Vector3": _NUMBERS,
    "Quaternion": {**_NUMBERS, "w": "double"},
    "Pose": {"position": "Vector3", "orientation": "Quaternion"},
    "CompressedImage": {"timestamp": "Time", "frame_id": "string", "data": "bytes", "format": "string"},
    "CompressedVideo": {"timestamp": "Time", "frame_id": "string", "data": "bytes", "format": "string"},
    "RawImage": {
        "timestamp": "Time",
        "frame_id": "string",
        **dict.fromkeys(("width", "height", "step"), "fixed32"),
        "encoding": "string",
        "data": "bytes",
    },
    "CameraCalibration": {
        "timestamp": "Time",
        "frame_id": "string",
        **dict.fromkeys(("width", "height"), "fixed32"),
        "distortion_model": "string",
        **dict.fromkeys("DKRP", "double[]"),
    },
    "PoseInFrame": {"timestamp": "Time", "frame_id": "string", "pose": "Pose"},
    "PosesInFrame": {"timestamp": "Time", "frame_id": "string", "poses": "Pose[]"},
    "FrameTransform": {
        "timestamp": "Time",
        **dict.fromkeys(("parent_frame_id", "child_frame_id"), "string"),
        "translation": "Vector3",
        "rotation": "Quaternion",
    },
    "FrameTransforms": {"transforms": "FrameTransform[]"},
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
        if encoding == "protobuf":
            with mcap_protobuf.writer.Writer(file) as writer:
                for e in events:
                    writer.write_message(e.topic, _as_protobuf(e.name, e.fields), e.time_ns, e.time_ns)
        elif encoding == "json":
            plain = Writer(file)
            plain.start()
            channels: dict[tuple[str, str], int] = {}
            for e in events:
                if (e.topic, e.name) not in channels:
                    schema = plain.register_schema(f"foxglove.{e.name}", "jsonschema", b'{"type": "object"}')
                    channels[e.topic, e.name] = plain.register_channel(e.topic, "json", schema)
                data = json.dumps(_with_times(e.fields, "nsec", as_text)).encode()
                plain.add_message(channels[e.topic, e.name], e.time_ns, data, e.time_ns)
            plain.finish()
        else:
            with mcap_ros2.writer.Writer(file) as writer:
                schemas: dict[str, Any] = {}
                for e in events:
                    ros = f"foxglove_msgs/{e.name}"
                    schemas.setdefault(ros, None)
                    schemas[ros] = schemas[ros] or writer.register_msgdef(schema_name(ros), schema_text(ros))
                    fields = {name.lower() if name in "DKRP" else name: v for name, v in e.fields.items()}
                    writer.write_message(e.topic, schemas[ros], _with_times(fields, "nanosec", bytes), e.time_ns)
    return path


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


def _as_protobuf(name: str, fields: dict[str, Any]) -> Any:
    message = _protobuf_classes()[f"foxglove.{name}"]()

    def fill(target: Any, values: dict[str, Any]) -> None:
        for key, value in values.items():
            if key == "timestamp":
                target.timestamp.seconds, target.timestamp.nanos = divmod(value, 10**9)
            elif isinstance(value, dict):
                getattr(target, key).SetInParent()
                fill(getattr(target, key), value)
            elif isinstance(value, list) and value and isinstance(value[0], dict):
                for one in value:
                    fill(getattr(target, key).add(), one)
            elif isinstance(value, list):
                getattr(target, key).extend(value)
            else:
                setattr(target, key, value)

    fill(message, fields)
    return message


@cache
def _protobuf_classes() -> dict[str, Any]:
    pool = descriptor_pool.DescriptorPool()
    pool.AddSerializedFile(timestamp_pb2.DESCRIPTOR.serialized_pb)  # pyright: ignore[reportAttributeAccessIssue]
    file = descriptor_pb2.FileDescriptorProto(name="foxglove.proto", package="foxglove", syntax="proto3")
    file.dependency.append("google/protobuf/timestamp.proto")
    kinds = descriptor_pb2.FieldDescriptorProto
    for name, fields in _PROTO.items():
        message = file.message_type.add(name=name)
        for number, (field_name, kind) in enumerate(fields.items(), 1):
            field = message.field.add(name=field_name, number=number, label=kinds.LABEL_OPTIONAL)
            if kind.endswith("[]"):
                field.label = kinds.LABEL_REPEATED
            kind = kind.removesuffix("[]")
            if kind == "Time" or kind in _PROTO:
                field.type = kinds.TYPE_MESSAGE
                field.type_name = ".google.protobuf.Timestamp" if kind == "Time" else f".foxglove.{kind}"
            else:
                field.type = getattr(kinds, f"TYPE_{kind.upper()}")
    pool.Add(file)
    return message_factory.GetMessageClassesForFiles(["foxglove.proto"], pool)


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
