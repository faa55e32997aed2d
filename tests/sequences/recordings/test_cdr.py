"""Bytes of ROS 2's messages, beside those of the library that is made for them."""

import struct
from collections.abc import Callable
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from mcap.records import Schema
from mcap_ros2 import _dynamic
from mcap_ros2._cdr import CdrWriter, EncapsulationKind
from mcap_ros2.decoder import DecoderFactory

from sequences.recordings.message_definitions import DEFINITIONS, decoder, encoder, schema_name, schema_text
from tests.helpers.tf_files import made_up

_READ = ["nav_msgs/Odometry", "sensor_msgs/CompressedImage", "sensor_msgs/CameraInfo", "tf2_msgs/TFMessage"]


def library_encoder(message_type: str) -> Callable[[dict[str, Any]], bytes]:
    return _dynamic.serialize_dynamic(schema_name(message_type), schema_text(message_type))[message_type]


def library_decoder(message_type: str) -> Callable[[bytes], Any]:
    text = schema_text(message_type).encode()
    schema = Schema(id=1, data=text, encoding="ros2msg", name=schema_name(message_type))
    decode = DecoderFactory().decoder_for("cdr", schema)
    assert decode is not None
    return decode


def as_object(message: Any) -> Any:
    """Fields of a message as attributes: the library takes a dict's `values` for its method."""
    if isinstance(message, list):
        return [as_object(each) for each in message]
    return (
        SimpleNamespace(**{n: as_object(each) for n, each in message.items()}) if isinstance(message, dict) else message
    )


def as_dict(message: Any) -> Any:
    """The fields of a message, ours or the library's, by name."""
    if isinstance(message, list):
        return [as_dict(each) for each in message]
    names = getattr(message, "__slots__", None) or getattr(message, "__dict__", None)
    return {name: as_dict(getattr(message, name)) for name in names} if names else message


@pytest.mark.parametrize("message_type", DEFINITIONS)
def test_messages_of_every_type_are_written_and_read_as_the_library_does(
    message_type: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(0)
    write, read = library_encoder(message_type), library_decoder(message_type)
    for message in [{}, *(made_up(message_type, rng) for _ in range(4))]:
        data = write(as_object(message))
        assert encoder(message_type)(message) == data
        with monkeypatch.context() as patch:
            patch.setattr(_dynamic, "CdrWriter", partial(CdrWriter, kind=EncapsulationKind.CDR_BE))
            big_endian = write(as_object(message))
        for each in (data, big_endian):
            assert as_dict(decoder(message_type)(each)) == as_dict(read(each))


@pytest.mark.parametrize("message_type", _READ)
def test_bytes_that_end_early_are_refused_where_the_library_refuses_them(message_type: str) -> None:
    data = encoder(message_type)(made_up(message_type, np.random.default_rng(3)))

    def tried(decode: Callable[[bytes], Any], end: int) -> Any:
        try:
            return as_dict(decode(data[:end]))
        except (struct.error, ValueError):
            return "refused"

    found = [tried(decoder(message_type), end) for end in range(len(data))]
    assert found == [tried(library_decoder(message_type), end) for end in range(len(data))]
    assert found.count("refused") > 20


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
    expected = library_encoder("geometry_msgs/PoseArray")({"header": header, "poses": parts})
    assert write({"header": header, "poses": rows}) == write({"header": header, "poses": parts}) == expected
    for row, part in zip(rows, parts, strict=True):
        expected = library_encoder("geometry_msgs/PoseStamped")({"header": header, "pose": part})
        assert encoder("geometry_msgs/PoseStamped")({"header": header, "pose": row}) == expected


@pytest.mark.parametrize(
    ("message_type", "message"),
    [
        ("geometry_msgs/PoseStamped", {"pose": np.zeros(6)}),
        ("geometry_msgs/PoseArray", {"poses": np.zeros((2, 6))}),
        ("geometry_msgs/PoseWithCovariance", {"covariance": [0.0] * 35}),
        ("visualization_msgs/Marker", {"colors": np.zeros((2, 4))}),  # which are no float64
        ("std_msgs/Header", {"stamp": {"sec": 2**31}}),
    ],
)
def test_fields_that_do_not_fit_their_type_are_refused(message_type: str, message: dict[str, Any]) -> None:
    with pytest.raises((ValueError, struct.error)):
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
        with pytest.raises(struct.error):
            decoder(message_type)(bytes(data))
