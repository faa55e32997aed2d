"""Bytes of ROS 2's messages, beside those of another library."""

import struct
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from mcap_ros2._dynamic import serialize_dynamic

from sequences.recordings.message_definitions import decoder, encoder, schema_name, schema_text
from tests.helpers.tf_files import MESSAGE_TYPES, made_up


def written_by_another_library(message_type: str, message: dict[str, Any]) -> bytes:
    return serialize_dynamic(schema_name(message_type), schema_text(message_type))[schema_name(message_type)](
        as_object(message)
    )


def as_object(message: Any) -> Any:
    """Fields of a message as attributes: the library takes a dict's `values` for its method."""
    if isinstance(message, list):
        return [as_object(each) for each in message]
    return (
        SimpleNamespace(**{n: as_object(each) for n, each in message.items()}) if isinstance(message, dict) else message
    )


@pytest.mark.parametrize("message_type", MESSAGE_TYPES)
def test_messages_of_every_type_are_written_as_by_another_library_and_read_again(message_type: str) -> None:
    rng = np.random.default_rng(0)
    for message in [{}, *(made_up(message_type, rng) for _ in range(4))]:
        data = encoder(message_type)(message)
        if message:
            assert data == written_by_another_library(message_type, message)
        assert encoder(message_type)(decoder(message_type)(data)) == data


@pytest.mark.parametrize("number", [0, 1, 3])
@pytest.mark.parametrize("frame", ["", "m", "map", "map1", "map45", "map4567"])
def test_poses_may_be_arrays_of_their_numbers(frame: str, number: int) -> None:
    rows = np.random.default_rng(1).normal(size=(number, 7))
    parts = [
        {
            "position": dict(zip("xyz", row[:3].tolist(), strict=True)),
            "orientation": dict(zip("xyzw", row[3:].tolist(), strict=True)),
        }
        for row in rows
    ]
    header = {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": frame}
    write = encoder("geometry_msgs/PoseArray")
    assert write({"header": header, "poses": rows}) == write({"header": header, "poses": parts})


@pytest.mark.parametrize(
    ("message_type", "message"),
    [
        ("geometry_msgs/PoseStamped", {"pose": np.zeros(6)}),
        ("geometry_msgs/PoseArray", {"header": {}, "poses": np.zeros((2, 6))}),
        ("geometry_msgs/PoseWithCovariance", {"covariance": [0.0] * 35}),
        ("std_msgs/Header", {"stamp": {"sec": 2**31}}),
    ],
)
def test_fields_that_do_not_fit_their_type_are_refused(message_type: str, message: dict[str, Any]) -> None:
    with pytest.raises(Exception, match=r"reshape|missing 1|Unexpected array length|format requires"):
        encoder(message_type)(message)


def test_a_list_that_claims_to_be_longer_than_its_message_is_refused_at_once() -> None:
    number = {"header": {"frame_id": "map"}, "distortion_model": "abc", "d": [1.0]}
    for message_type, message, in_front in (
        ("nav_msgs/Path", {"header": {"frame_id": "map"}, "poses": [{"pose": [1.0] * 7}]}, 24),
        ("sensor_msgs/CameraInfo", number, 8),
    ):
        data = bytearray(encoder(message_type)(message))
        at = data.index(struct.pack("<d", 1.0)) - in_front
        assert data[at : at + 4] == struct.pack("<I", 1)
        data[at : at + 4] = struct.pack("<I", 2**32 - 1)
        with pytest.raises(Exception, match=r"Could not deserialize|Invalid sequence length"):
            decoder(message_type)(bytes(data))


def test_bytes_behind_a_message_are_ignored() -> None:
    data = encoder("nav_msgs/Odometry")({"child_frame_id": "base_link"})
    assert decoder("nav_msgs/Odometry")(data + bytes(8)).child_frame_id == "base_link"
