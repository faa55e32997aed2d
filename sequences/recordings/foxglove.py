"""Foxglove's messages of images, poses, transforms and intrinsics -> the fields of ROS 2's that say the same.

They come as protobuf, as JSON, or from ROS 2; the three differ in names of fields, and these differences end here.
"""

from __future__ import annotations

import base64
import binascii
from collections.abc import Callable, Sequence
from functools import lru_cache
from types import SimpleNamespace
from typing import Any

from filtering.errors import quoted
from sequences.errors import SequenceError

_PREFIXES = {"foxglove.": ("protobuf", "json"), "foxglove_msgs/": ("cdr",)}  # and how such types are encoded
_MAX_STAMP_S = 2**32  # of nanoseconds since 1970 that 64 bits hold with ease


def read_as(message_type: str) -> str:
    """The ROS 2 type as which messages of a type are read: itself, where it is none of Foxglove's."""
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


def converter(message_type: str) -> Callable[[Any], SimpleNamespace]:
    """A function from the fields of a message to those of the ROS 2 type as which it is read.

    It raises SequenceError where a field is missing or is not of its kind.
    """
    name = _own_name(message_type)
    if name is None:
        return lambda message: message
    convert = _TYPES[name][1]

    def converted(message: Any) -> SimpleNamespace:
        try:
            return convert(message)
        except AttributeError as error:  # JSON leaves out what it likes
            raise SequenceError(f"field {error.name!r} is missing") from error

    return converted


@lru_cache(maxsize=256)
def _own_name(message_type: str) -> str | None:
    """The name without what says that it is Foxglove's; None for types of others, and those that nothing reads."""
    names = (message_type.removeprefix(prefix) for prefix in _PREFIXES if message_type.startswith(prefix))
    return next((name for name in names if name in _TYPES), None)


def _number(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise SequenceError(f"{quoted(value)} where a number is expected")
    return float(value)


def _whole(value: object) -> int:
    if isinstance(value, bool) or not isinstance(value, int):
        raise SequenceError(f"{quoted(value)} where a whole number is expected")
    return value


def _text(value: object) -> str:
    if not isinstance(value, str):
        raise SequenceError(f"{quoted(value)} where text is expected")
    return value


def _list(value: Any) -> Sequence[Any]:
    if isinstance(value, str | bytes | SimpleNamespace) or not hasattr(value, "__len__"):
        raise SequenceError(f"{quoted(value)} where a list is expected")
    return value


def _data(value: Any) -> bytes:
    """Bytes, which JSON writes in base64."""
    if not isinstance(value, str):
        return bytes(value)
    try:
        return base64.b64decode(value, validate=True)
    except (binascii.Error, ValueError) as error:
        raise SequenceError(f"data of {len(value)} characters is no base64: {error}") from error


def _numbers(message: Any, name: str, count: int | None = None) -> list[float]:
    """The numbers of a calibration, whose names ROS 2 does not allow to be capitals; none at all are zeros."""
    values = [_number(value) for value in _list(getattr(message, name if hasattr(message, name) else name.upper()))]
    if count is None or len(values) == count:
        return values
    if values:
        raise SequenceError(f"{name.upper()} has {len(values)} numbers, expected {count}")
    return [0.0] * count


def _header(message: Any, frame_id: object) -> SimpleNamespace:
    has_field = getattr(message, "HasField", None)  # protobuf would say 1970
    if has_field is not None and not has_field("timestamp"):
        raise SequenceError("field 'timestamp' is missing")
    time = message.timestamp
    if hasattr(time, "seconds"):  # protobuf
        seconds, nanoseconds = time.seconds, time.nanos
    else:
        seconds, nanoseconds = time.sec, time.nanosec if hasattr(time, "nanosec") else time.nsec
    seconds, nanoseconds = _whole(seconds), _whole(nanoseconds)
    if not (0 <= seconds < _MAX_STAMP_S and 0 <= nanoseconds < 1_000_000_000):
        raise SequenceError(f"timestamp of {seconds} s and {nanoseconds} ns, expected one since 1970")
    return SimpleNamespace(stamp=SimpleNamespace(sec=seconds, nanosec=nanoseconds), frame_id=_text(frame_id))


def _vector(value: Any) -> SimpleNamespace:
    return SimpleNamespace(x=_number(value.x), y=_number(value.y), z=_number(value.z))


def _quaternion(value: Any) -> SimpleNamespace:
    return SimpleNamespace(x=_number(value.x), y=_number(value.y), z=_number(value.z), w=_number(value.w))


def _pose(value: Any) -> SimpleNamespace:
    return SimpleNamespace(position=_vector(value.position), orientation=_quaternion(value.orientation))


def _compressed(message: Any) -> SimpleNamespace:
    header = _header(message, message.frame_id)
    return SimpleNamespace(header=header, format=_text(message.format), data=_data(message.data))


def _raw_image(message: Any) -> SimpleNamespace:
    return SimpleNamespace(
        header=_header(message, message.frame_id),
        width=_whole(message.width),
        height=_whole(message.height),
        encoding=_text(message.encoding),
        is_bigendian=0,
        step=_whole(message.step),
        data=_data(message.data),
    )


def _camera_calibration(message: Any) -> SimpleNamespace:
    return SimpleNamespace(
        header=_header(message, message.frame_id),
        width=_whole(message.width),
        height=_whole(message.height),
        distortion_model=_text(message.distortion_model),
        d=_numbers(message, "d"),
        k=_numbers(message, "k", 9),
        r=_numbers(message, "r", 9),
        p=_numbers(message, "p", 12),
        binning_x=0,
        binning_y=0,
        roi=SimpleNamespace(x_offset=0, y_offset=0, width=0, height=0, do_rectify=False),
    )


def _pose_in_frame(message: Any) -> SimpleNamespace:
    return SimpleNamespace(header=_header(message, message.frame_id), pose=_pose(message.pose))


def _poses_in_frame(message: Any) -> SimpleNamespace:
    header = _header(message, message.frame_id)
    poses = [SimpleNamespace(header=header, pose=_pose(pose)) for pose in _list(message.poses)]
    return SimpleNamespace(header=header, poses=poses)


def _stamped_transform(message: Any) -> SimpleNamespace:
    return SimpleNamespace(
        header=_header(message, message.parent_frame_id),
        child_frame_id=_text(message.child_frame_id),
        transform=SimpleNamespace(translation=_vector(message.translation), rotation=_quaternion(message.rotation)),
    )


def _frame_transform(message: Any) -> SimpleNamespace:
    return SimpleNamespace(transforms=[_stamped_transform(message)])


def _frame_transforms(message: Any) -> SimpleNamespace:
    return SimpleNamespace(transforms=[_stamped_transform(one) for one in _list(message.transforms)])


_TYPES: dict[str, tuple[str, Callable[[Any], SimpleNamespace]]] = {
    "CompressedImage": ("sensor_msgs/CompressedImage", _compressed),
    "RawImage": ("sensor_msgs/Image", _raw_image),
    "CompressedVideo": ("foxglove_msgs/CompressedVideo", _compressed),
    "CameraCalibration": ("sensor_msgs/CameraInfo", _camera_calibration),
    "PoseInFrame": ("geometry_msgs/PoseStamped", _pose_in_frame),
    "PosesInFrame": ("nav_msgs/Path", _poses_in_frame),
    "FrameTransform": ("tf2_msgs/TFMessage", _frame_transform),
    "FrameTransforms": ("tf2_msgs/TFMessage", _frame_transforms),
}
