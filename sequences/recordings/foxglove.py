"""Foxglove's messages of images, poses, transforms and intrinsics -> the fields of the ROS 2 types of the same content.

They come as protobuf, as JSON, or from ROS 2; the names of some fields differ between the three.
"""

from __future__ import annotations

import base64
import binascii
from collections.abc import Callable
from functools import cache, lru_cache
from types import SimpleNamespace
from typing import Any

from filtering.errors import quoted
from sequences.errors import SequenceError
from sequences.recordings.message_definitions import schema_text

_PREFIXES = {"foxglove.": ("protobuf", "json"), "foxglove_msgs/": ("cdr",)}  # of types, with their encodings
_MAX_STAMP_S = 2**32  # of nanoseconds since 1970 that 64 bits hold with ease
_KINDS: dict[str, tuple[type | tuple[type, ...], str]] = {
    "float64": ((int, float), "a number"),
    "uint32": (int, "a whole number"),
    "string": (str, "text"),
}


def read_as(message_type: str) -> str:
    """The ROS 2 type as which messages of a type are read: itself, unless it is Foxglove's."""
    name = _own_name(message_type)
    return _TYPES[name][0] if name is not None else message_type


def is_transforms(message_type: str) -> bool:
    """Whether messages of a type are Foxglove's transforms."""
    return _own_name(message_type) is not None and read_as(message_type) == "tf2_msgs/TFMessage"


def encodings(message_type: str) -> tuple[str, ...]:
    """How messages of a type may be serialized."""
    if _own_name(message_type) is None:
        return ("cdr",)
    return next(known for prefix, known in _PREFIXES.items() if message_type.startswith(prefix))


def converter(message_type: str) -> Callable[[Any], Any]:
    """A function from the fields of a message to those of the ROS 2 type as which it is read.

    It raises SequenceError where a field is missing or is not of its kind.
    """
    name = _own_name(message_type)
    if name is None:
        return lambda message: message
    convert = _TYPES[name][1]

    def converted(message: Any) -> SimpleNamespace:
        try:
            return convert(_checked(f"foxglove_msgs/{name}", message))
        except AttributeError as error:  # JSON may leave out any field
            raise SequenceError(f"field {error.name!r} is missing") from error

    return converted


@lru_cache(maxsize=256)
def _own_name(message_type: str) -> str | None:
    """Foxglove's name of a type without its prefix; None for types of others, and those that nothing reads."""
    names = (message_type.removeprefix(prefix) for prefix in _PREFIXES if message_type.startswith(prefix))
    return next((name for name in names if name in _TYPES), None)


# --- fields by their definitions ------------------------------------------------------------------


@cache
def _fields(message_type: str) -> list[tuple[str, str, bool]]:
    """Kind and name of each field, and whether it is a single value."""
    fields = [line.split() for line in schema_text(message_type).split("=")[0].splitlines()]
    return [(kind, name, "[" not in kind and not kind.endswith("/Time")) for kind, name in fields]


def _checked(message_type: str, message: Any) -> SimpleNamespace:
    fields = SimpleNamespace()
    for kind, name, is_single in _fields(message_type):
        value = _of_kind(kind, getattr(message, name)) if is_single else _field(kind, name, message)
        setattr(fields, name, value)
    return fields


def _field(kind: str, name: str, message: Any) -> Any:
    if kind.endswith("/Time"):
        return _stamp(message)
    if kind.startswith("float64[") and not hasattr(message, name):
        name = name.upper()  # of a calibration, where ROS 2 does not allow capitals
    value = getattr(message, name)
    if kind == "uint8[]":
        return _data(value)
    base, _, number = kind.removesuffix("]").partition("[")
    if isinstance(value, str | bytes | SimpleNamespace) or not hasattr(value, "__len__"):
        raise SequenceError(f"{quoted(value)} where a list is expected")
    values = [_of_kind(base, each) for each in value]
    if number and len(values) not in (0, int(number)):
        raise SequenceError(f"{name.upper()} has {len(values)} numbers, expected {number}")
    return values or [0.0] * int(number or 0)


def _of_kind(kind: str, value: Any) -> Any:
    if type(value) is float and kind == "float64":
        return value
    if kind not in _KINDS:
        return _checked(kind, value)
    types, expected = _KINDS[kind]
    if isinstance(value, bool) or not isinstance(value, types):
        raise SequenceError(f"{quoted(value)} where {expected} is expected")
    return float(value) if kind == "float64" else value


def _data(value: Any) -> bytes:
    """Bytes, which JSON writes in base64."""
    if not isinstance(value, str):
        return bytes(value)
    try:
        return base64.b64decode(value, validate=True)
    except (binascii.Error, ValueError) as error:
        raise SequenceError(f"data of {len(value)} characters is no base64: {error}") from error


def _stamp(message: Any) -> SimpleNamespace:
    has_field = getattr(message, "HasField", None)  # protobuf would answer 1970
    if has_field is not None and not has_field("timestamp"):
        raise SequenceError("field 'timestamp' is missing")
    time = message.timestamp
    names = ("sec", "nanosec" if hasattr(time, "nanosec") else "nsec")
    if hasattr(time, "seconds"):  # protobuf
        names = ("seconds", "nanos")
    seconds, nanoseconds = (_of_kind("uint32", getattr(time, name)) for name in names)
    if not (0 <= seconds < _MAX_STAMP_S and 0 <= nanoseconds < 1_000_000_000):
        raise SequenceError(f"timestamp of {seconds} s and {nanoseconds} ns, expected one since 1970")
    return SimpleNamespace(sec=seconds, nanosec=nanoseconds)


# --- the same in ROS 2 ----------------------------------------------------------------------------


def _with_header(fields: SimpleNamespace, **more: object) -> SimpleNamespace:
    header = SimpleNamespace(stamp=fields.timestamp, frame_id=fields.frame_id)
    return SimpleNamespace(header=header, **vars(fields), **more)


def _path(fields: SimpleNamespace) -> SimpleNamespace:
    path = _with_header(fields)
    path.poses = [SimpleNamespace(header=path.header, pose=pose) for pose in fields.poses]
    return path


def _transform(fields: SimpleNamespace) -> SimpleNamespace:
    return SimpleNamespace(
        header=SimpleNamespace(stamp=fields.timestamp, frame_id=fields.parent_frame_id),
        child_frame_id=fields.child_frame_id,
        transform=SimpleNamespace(translation=fields.translation, rotation=fields.rotation),
    )


_WHOLE_SENSOR = SimpleNamespace(x_offset=0, y_offset=0, width=0, height=0, do_rectify=False)
_TYPES: dict[str, tuple[str, Callable[[SimpleNamespace], SimpleNamespace]]] = {
    "CompressedImage": ("sensor_msgs/CompressedImage", _with_header),
    "RawImage": ("sensor_msgs/Image", lambda fields: _with_header(fields, is_bigendian=0)),
    "CompressedVideo": ("foxglove_msgs/CompressedVideo", _with_header),
    "CameraCalibration": (
        "sensor_msgs/CameraInfo",
        lambda fields: _with_header(fields, binning_x=0, binning_y=0, roi=_WHOLE_SENSOR),
    ),
    "PoseInFrame": ("geometry_msgs/PoseStamped", _with_header),
    "PosesInFrame": ("nav_msgs/Path", _path),
    "FrameTransform": ("tf2_msgs/TFMessage", lambda fields: SimpleNamespace(transforms=[_transform(fields)])),
    "FrameTransforms": (
        "tf2_msgs/TFMessage",
        lambda fields: SimpleNamespace(transforms=[_transform(each) for each in fields.transforms]),
    ),
}
