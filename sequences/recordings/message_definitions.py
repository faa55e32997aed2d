"""The ROS 2 message types that are read and written, as text, and their bytes (CDR).

Numbers are aligned to their size, counted from behind the four bytes of the header. So numbers that follow each other,
of whichever message within the message, are one struct, which depends only on where within eight bytes it begins.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, make_dataclass
from functools import cache, lru_cache, partial
from itertools import islice
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

DEFINITIONS = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "builtin_interfaces/Duration": "int32 sec\nuint32 nanosec",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "std_msgs/Empty": "uint8 structure_needs_at_least_one_member",
    "rosgraph_msgs/Clock": "builtin_interfaces/Time clock",
    "diagnostic_msgs/KeyValue": "string key\nstring value",
    "diagnostic_msgs/DiagnosticStatus": (
        "byte level\nstring name\nstring message\nstring hardware_id\ndiagnostic_msgs/KeyValue[] values"
    ),
    "diagnostic_msgs/DiagnosticArray": "std_msgs/Header header\ndiagnostic_msgs/DiagnosticStatus[] status",
    "std_msgs/ColorRGBA": "float32 r\nfloat32 g\nfloat32 b\nfloat32 a",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/Twist": "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular",
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation",
    "geometry_msgs/PoseWithCovariance": "geometry_msgs/Pose pose\nfloat64[36] covariance",
    "geometry_msgs/TwistWithCovariance": "geometry_msgs/Twist twist\nfloat64[36] covariance",
    "geometry_msgs/PoseStamped": "std_msgs/Header header\ngeometry_msgs/Pose pose",
    "geometry_msgs/PoseWithCovarianceStamped": "std_msgs/Header header\ngeometry_msgs/PoseWithCovariance pose",
    "geometry_msgs/PoseArray": "std_msgs/Header header\ngeometry_msgs/Pose[] poses",
    "geometry_msgs/TransformStamped": (
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform"
    ),
    "nav_msgs/Path": "std_msgs/Header header\ngeometry_msgs/PoseStamped[] poses",
    "tf2_msgs/TFMessage": "geometry_msgs/TransformStamped[] transforms",
    "nav_msgs/Odometry": (
        "std_msgs/Header header\nstring child_frame_id\n"
        "geometry_msgs/PoseWithCovariance pose\ngeometry_msgs/TwistWithCovariance twist"
    ),
    "sensor_msgs/CompressedImage": "std_msgs/Header header\nstring format\nuint8[] data",
    "sensor_msgs/Image": (
        "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\n"
        "uint8 is_bigendian\nuint32 step\nuint8[] data"
    ),
    "sensor_msgs/RegionOfInterest": "uint32 x_offset\nuint32 y_offset\nuint32 height\nuint32 width\nbool do_rectify",
    "sensor_msgs/CameraInfo": (
        "std_msgs/Header header\nuint32 height\nuint32 width\nstring distortion_model\nfloat64[] d\n"
        "float64[9] k\nfloat64[9] r\nfloat64[12] p\nuint32 binning_x\nuint32 binning_y\n"
        "sensor_msgs/RegionOfInterest roi"
    ),
    "ffmpeg_image_transport_msgs/FFMPEGPacket": (
        "std_msgs/Header header\nint32 width\nint32 height\nstring encoding\nuint64 pts\nuint8 flags\n"
        "bool is_bigendian\nuint8[] data"
    ),
    "foxglove_msgs/CompressedImage": (
        "builtin_interfaces/Time timestamp\nstring frame_id\nuint8[] data\nstring format"
    ),
    "foxglove_msgs/CompressedVideo": (
        "builtin_interfaces/Time timestamp\nstring frame_id\nuint8[] data\nstring format"
    ),
    "foxglove_msgs/RawImage": (
        "builtin_interfaces/Time timestamp\nstring frame_id\nuint32 width\nuint32 height\nstring encoding\n"
        "uint32 step\nuint8[] data"
    ),
    "foxglove_msgs/CameraCalibration": (
        "builtin_interfaces/Time timestamp\nstring frame_id\nuint32 width\nuint32 height\n"
        "string distortion_model\nfloat64[] d\nfloat64[9] k\nfloat64[9] r\nfloat64[12] p"
    ),
    "foxglove_msgs/PoseInFrame": "builtin_interfaces/Time timestamp\nstring frame_id\ngeometry_msgs/Pose pose",
    "foxglove_msgs/PosesInFrame": "builtin_interfaces/Time timestamp\nstring frame_id\ngeometry_msgs/Pose[] poses",
    "foxglove_msgs/FrameTransform": (
        "builtin_interfaces/Time timestamp\nstring parent_frame_id\nstring child_frame_id\n"
        "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation"
    ),
    "foxglove_msgs/FrameTransforms": "foxglove_msgs/FrameTransform[] transforms",
    "visualization_msgs/UVCoordinate": "float32 u\nfloat32 v",
    "visualization_msgs/MeshFile": "string filename\nuint8[] data",
    "visualization_msgs/Marker": (
        "std_msgs/Header header\nstring ns\nint32 id\nint32 type\nint32 action\n"
        "geometry_msgs/Pose pose\ngeometry_msgs/Vector3 scale\nstd_msgs/ColorRGBA color\n"
        "builtin_interfaces/Duration lifetime\nbool frame_locked\ngeometry_msgs/Point[] points\n"
        "std_msgs/ColorRGBA[] colors\nstring texture_resource\nsensor_msgs/CompressedImage texture\n"
        "visualization_msgs/UVCoordinate[] uv_coordinates\nstring text\nstring mesh_resource\n"
        "visualization_msgs/MeshFile mesh_file\nbool mesh_use_embedded_materials"
    ),
    "visualization_msgs/MarkerArray": "visualization_msgs/Marker[] markers",
}


def schema_text(message_type: str) -> str:
    """The definition of a type such as `nav_msgs/Odometry`, followed by those of every type within it."""
    names = [message_type]
    for name in names:  # grows while it is walked: the types within types
        names += [t for t in re.findall(r"^(\w+/\w+)", DEFINITIONS[name], re.MULTILINE) if t not in names]
    parts = [DEFINITIONS[message_type], *(f"MSG: {name}\n{DEFINITIONS[name]}" for name in names[1:])]
    return f"\n{'=' * 80}\n".join(parts) + "\n"


def schema_name(message_type: str) -> str:
    """The name of a type in files of ROS 2: `nav_msgs/msg/Odometry`."""
    return message_type.replace("/", "/msg/")


@lru_cache(maxsize=256)
def begins_with_stamp(message_type: str, definition: bytes = b"") -> bool:
    """Whether a message's bytes begin with seconds and nanoseconds; a file's definition counts for unknown types."""
    text = DEFINITIONS.get(message_type) or definition.decode(errors="replace")
    lines = [line.split("#")[0].strip() for line in text.splitlines()]
    first = next((line for line in lines if line and "=" not in line), "")
    return first.startswith(("std_msgs/Header ", "Header ", "builtin_interfaces/Time "))


@cache
def decoder(message_type: str) -> Callable[[bytes], SimpleNamespace]:
    """A function from the CDR bytes of a message to its fields, which follows the definitions above.

    These types have not changed in ROS 2, and recorders leave their text out where they do not find it. Bytes behind
    the message are ignored, and a list of bytes at its end may be cut off. Bytes that end early, or text that is not
    UTF-8, raise ValueError or struct.error.
    """
    return partial(_read_message, _layout_of(message_type))


@cache
def encoder(message_type: str) -> Callable[[Mapping[str, Any]], bytes]:
    """A function from the fields of a message, by name, to its little-endian CDR bytes.

    Missing fields are zero or empty. A message within it that consists of numbers may be an array of them in their
    order; a list of n messages that consist of k float64, one (n, k). Fields with a wrong number of numbers, or numbers
    out of range, raise ValueError or struct.error.
    """
    return partial(_write_message, _layout_of(message_type))


# --- CDR ------------------------------------------------------------------------------------------

_HEADER = 4  # bytes; the last bit of the second is set where numbers are little-endian
_CODES = {
    "bool": "?",
    "byte": "B",
    "uint8": "B",
    "int32": "i",
    "uint32": "I",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}


@dataclass(frozen=True)
class _List:
    """A list of any length, of numbers of a code or of messages. Text is a list of characters."""

    of: _Layout | str


class _Field(NamedTuple):
    """A field: its name, the layout of a message or the length of an array, else None; its values if left out."""

    name: str
    kind: _Layout | int | None
    absent: list[Any]


@dataclass(frozen=True)
class _Layout:
    """The bytes of a message type.

    Attributes:
        made: Class of its messages as they are read; with slots, as paths have many poses.
        fields: Its fields.
        parts: Numbers in a row, by their codes, and lists, in the order of the bytes.
    """

    made: type[SimpleNamespace]
    fields: tuple[_Field, ...]
    parts: tuple[str | _List, ...]


_TEXT = _List("text")


@cache
def _layout_of(message_type: str) -> _Layout:
    fields: list[_Field] = []
    parts: list[str | _List] = []
    for line in DEFINITIONS[message_type].splitlines():
        kind, name = line.split()
        match = re.fullmatch(r"([\w/]+)(\[(\d*)\])?", kind)
        assert match is not None
        base, is_list, length = match.group(1, 2, 3)
        of = _layout_of(base) if "/" in base else _CODES.get(base)
        added: tuple[str | _List, ...]
        if is_list and not length:
            assert of is not None
            field, added = _Field(name, None, [()]), (_List(of),)
        elif isinstance(of, _Layout):
            field, added = _Field(name, of, [value for each in of.fields for value in each.absent]), of.parts
        elif of is not None:
            number = int(length or 1)
            field, added = _Field(name, number if is_list else None, [0] * number), (of * number,)
        else:
            field, added = _Field(name, None, [""]), (_TEXT,)
        fields.append(field)
        for part in added:
            if isinstance(part, str) and parts and isinstance(parts[-1], str):
                parts[-1] += part
            else:
                parts.append(part)
    names = [field.name for field in fields]
    made = make_dataclass(message_type.rpartition("/")[2], names, bases=(SimpleNamespace,), slots=True)
    return _Layout(made, tuple(fields), tuple(parts))


@cache
def _struct(codes: str, order: str, begin: int) -> struct.Struct:
    """Numbers in a row with their gaps, where the first lies `begin` bytes behind a multiple of eight."""
    form, at = order, begin
    for code in codes:
        size = struct.calcsize(f"<{code}")
        form += "x" * (-at % size) + code
        at += -at % size + size
    return struct.Struct(form)


def _read_message(layout: _Layout, data: bytes) -> SimpleNamespace:
    if len(data) < _HEADER:
        raise ValueError(f"{len(data)} bytes, expected a header of {_HEADER} at least")
    return _read(layout, data, _HEADER, "<" if data[1] & 1 else ">")[0]


def _read(layout: _Layout, data: bytes, at: int, order: str) -> tuple[SimpleNamespace, int]:
    """The message that begins at some byte, and where it ends."""
    values: list[Any] = []
    for part in layout.parts:
        if isinstance(part, str):
            numbers = _struct(part, order, (at - _HEADER) % 8)
            values += numbers.unpack_from(data, at)
            at += numbers.size
            continue
        prefix = _struct("I", order, (at - _HEADER) % 8)
        (count,) = prefix.unpack_from(data, at)
        at += prefix.size
        if part is _TEXT:
            values.append(data[at : at + count - 1].decode() if count else "")
            at += count
        elif part.of == "B":
            values.append(data[at : at + count])
            at += count
        elif isinstance(part.of, str):
            at += -(at - _HEADER) % struct.calcsize(part.of) if count else 0
            values.append(list(struct.unpack_from(f"{order}{count}{part.of}", data, at)))
            at += count * struct.calcsize(part.of)
        else:
            messages = []
            for _ in range(count):
                message, at = _read(part.of, data, at, order)
                messages.append(message)
            values.append(messages)
    return _named(layout, iter(values)), at


def _named(layout: _Layout, values: Iterator[Any]) -> SimpleNamespace:
    fields = [
        next(values)
        if kind is None
        else _named(kind, values)
        if isinstance(kind, _Layout)
        else list(islice(values, kind))
        for _, kind, _ in layout.fields
    ]
    return layout.made(*fields)


def _write_message(layout: _Layout, message: Mapping[str, Any]) -> bytes:
    out = bytearray(b"\x00\x01\x00\x00")
    _write(layout, message, out)
    return bytes(out)


def _write(layout: _Layout, message: Mapping[str, Any], out: bytearray) -> None:
    values = iter(_values(layout, message))
    for part in layout.parts:
        if isinstance(part, str):
            out += _struct(part, "<", (len(out) - _HEADER) % 8).pack(*islice(values, len(part)))
            continue
        value = next(values)
        if part is _TEXT:
            value = value.encode() + b"\0"
        out += _struct("I", "<", (len(out) - _HEADER) % 8).pack(len(value))
        if isinstance(value, bytes):
            out += value
        elif isinstance(part.of, _Layout) and not isinstance(value, np.ndarray):
            for each in value:
                _write(part.of, each, out)
        elif len(value):
            row = part.of.parts if isinstance(part.of, _Layout) else (part.of,)
            numbers = np.asarray(value, "<f8").reshape(len(value), -1)
            if row != ("d" * numbers.shape[1],):
                raise ValueError(f"a list of {numbers.shape[1]} float64 each, expected {row}")
            out += bytes(-(len(out) - _HEADER) % 8) + numbers.tobytes()


def _values(layout: _Layout, message: Mapping[str, Any]) -> list[Any]:
    """The numbers of a message one by one, and its lists."""
    values: list[Any] = []
    for name, kind, absent in layout.fields:
        value = message.get(name)
        if value is None:
            values += absent
        elif kind is None:
            values.append(value)
        else:
            if isinstance(value, np.ndarray):
                value = value.ravel().tolist()
            added = _values(kind, value) if isinstance(value, Mapping) and isinstance(kind, _Layout) else value
            if len(added) != len(absent):
                raise ValueError(f"{name} has {len(added)} numbers, expected {len(absent)}")
            values += added
    return values
