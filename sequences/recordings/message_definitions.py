"""ROS 2 message types and their bytes (CDR), by the library `rosbags`."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, lru_cache, partial
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

_STAMPED = "builtin_interfaces/Time timestamp\nstring frame_id\n"
_FURTHER = {
    "ffmpeg_image_transport_msgs/FFMPEGPacket": (
        "std_msgs/Header header\nint32 width\nint32 height\nstring encoding\nuint64 pts\nuint8 flags\n"
        "bool is_bigendian\nuint8[] data"
    ),
    "foxglove_msgs/CompressedImage": f"{_STAMPED}uint8[] data\nstring format",
    "foxglove_msgs/CompressedVideo": f"{_STAMPED}uint8[] data\nstring format",
    "foxglove_msgs/RawImage": f"{_STAMPED}uint32 width\nuint32 height\nstring encoding\nuint32 step\nuint8[] data",
    "foxglove_msgs/CameraCalibration": (
        f"{_STAMPED}uint32 width\nuint32 height\nstring distortion_model\nfloat64[] d\nfloat64[9] k\nfloat64[9] r\n"
        "float64[12] p"
    ),
    "foxglove_msgs/PoseInFrame": f"{_STAMPED}geometry_msgs/Pose pose",
    "foxglove_msgs/PosesInFrame": f"{_STAMPED}geometry_msgs/Pose[] poses",
    "foxglove_msgs/FrameTransform": (
        "builtin_interfaces/Time timestamp\nstring parent_frame_id\nstring child_frame_id\n"
        "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation"
    ),
    "foxglove_msgs/FrameTransforms": "foxglove_msgs/FrameTransform[] transforms",
}
_POSE_ARRAY = "geometry_msgs/msg/PoseArray"
_SINGLE, _MESSAGE = 1, 2  # kinds of fields by the library's numbers; others are arrays and lists


@cache
def message_types() -> Typestore:
    """The known types: those of ROS 2 Humble, which later distributions have unchanged, and some of Foxglove."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore  # 0.1 s, which every command would pay

    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in _FURTHER.items():
        store.register(get_types_from_msg(text, schema_name(name)))
    return store


def is_known(message_type: str) -> bool:
    """Whether a type such as `nav_msgs/Odometry` can be read and written."""
    return schema_name(message_type) in message_types().fielddefs


def schema_text(message_type: str) -> str:
    """The definition of a type such as `nav_msgs/Odometry`, followed by those of every type within it."""
    return message_types().generate_msgdef(schema_name(message_type), ros_version=2)[0]


def schema_name(message_type: str) -> str:
    """The name of a type in files of ROS 2: `nav_msgs/msg/Odometry`."""
    return message_type.replace("/", "/msg/")


@lru_cache(maxsize=256)
def begins_with_stamp(message_type: str, definition: bytes = b"") -> bool:
    """Whether a message's bytes begin with seconds and nanoseconds; a file's definition counts for unknown types."""
    text = schema_text(message_type) if is_known(message_type) else definition.decode(errors="replace")
    lines = [line.split("#")[0].strip() for line in text.splitlines()]
    first = next((line for line in lines if line and "=" not in line), "")
    return first.startswith(("std_msgs/Header ", "Header ", "builtin_interfaces/Time "))


@cache
def decoder(message_type: str) -> Callable[[bytes], Any]:
    """A function from the CDR bytes of a message to its fields, with numpy arrays for lists of numbers.

    Bytes behind the message are ignored. Damaged bytes raise exceptions.
    """
    return partial(_decode, message_types().get_msgdef(schema_name(message_type)))


def _decode(definition: Any, data: bytes) -> Any:
    if len(data) < 4 or data[0] != 0 or data[1] > 1:
        raise ValueError(f"{len(data)} bytes, expected a header of CDR")
    function = definition.deserialize_cdr_le if data[1] else definition.deserialize_cdr_be
    return function(data[4:], 0, definition.cls, message_types())[0]


@cache
def encoder(message_type: str) -> Callable[[Any], bytes]:
    """A function from the fields of a message, a dict, to its little-endian CDR bytes.

    Missing fields are zero or empty. A message, or one within it, may be as `decoder` returns it; where it consists of
    numbers it may be an array of them in their order, (k,), and a list of n of these (n, k). Fields that do not fit
    raise exceptions.
    """
    return partial(_encode, schema_name(message_type))


def _encode(name: str, fields: Any) -> bytes:
    poses = fields.get("poses") if name == _POSE_ARRAY and isinstance(fields, dict) else None
    if isinstance(poses, np.ndarray) and len(poses):
        # Hundreds of particles come with each image: their numbers as they lie in memory, behind their count.
        data = _encode(name, {"header": fields["header"]})[:-4] + len(poses).to_bytes(4, "little")
        return data + bytes(-(len(data) - 4) % 8) + poses.reshape(-1, 7).astype("<f8").tobytes()
    return bytes(message_types().serialize_cdr(_message(name, fields), name))


def _message(name: str, fields: Any) -> Any:
    """A message of the library: itself, or from its fields by name, or from its numbers in their order."""
    if hasattr(fields, "__msgtype__"):
        return fields
    if isinstance(fields, dict):
        kinds = _fields(name)
        given = {field: _value(*kinds[field], value) for field, value in fields.items() if value is not None}
        return message_types().types[name](**(_absent(name) | given))
    numbers = fields.tolist() if isinstance(fields, np.ndarray) else fields
    parts = [of for kind, of in _fields(name).values() if kind == _MESSAGE]
    if parts:  # of a pose or a transform
        numbers = _message(parts[0], numbers[:3]), _message(parts[1], numbers[3:])
    return message_types().types[name](*numbers)


def _value(kind: int, of: Any, value: Any) -> Any:
    """The value of a field of some kind: a number or text, a message, or several of either."""
    if kind == _SINGLE:
        return value
    if kind == _MESSAGE:
        return _message(of, value)
    (kind_of_each, each), _ = of
    if kind_of_each == _MESSAGE:
        return [_message(each, fields) for fields in value]
    return np.frombuffer(value, np.uint8) if isinstance(value, bytes) else np.ravel(value).astype(each[0])


@cache
def _fields(name: str) -> dict[str, tuple[int, Any]]:
    return dict(message_types().fielddefs[name][1])


@cache
def _absent(name: str) -> dict[str, Any]:
    """Values of the fields that are not given: numbers are zero, texts and lists empty."""
    values: dict[str, Any] = {}
    for field, (kind, of) in _fields(name).items():
        if kind == _SINGLE:
            values[field] = "" if of[0] == "string" else 0
        elif kind == _MESSAGE:
            values[field] = _message(of, {})
        else:
            (kind_of_each, each), length = of
            values[field] = np.zeros(length, each[0]) if kind_of_each == _SINGLE else []
    return values
