"""Bytes of ROS 2's messages, beside those of the library that is made for them."""

import struct
from typing import Any

import numpy as np
import pytest
from mcap.records import Schema
from mcap_ros2._dynamic import serialize_dynamic
from mcap_ros2.decoder import DecoderFactory

from sequences.recordings.message_definitions import DEFINITIONS, decoder, encoder, schema_name, schema_text

_NUMBERS = {"bool": 2, "uint8": 200, "int32": 2**31, "uint32": 2**32, "uint64": 2**63}


def made_up(message_type: str, rng: np.random.Generator) -> dict[str, Any]:
    """A message of a type: texts of all lengths about eight, lists of none to three."""

    def one(kind: str) -> Any:
        if "/" in kind:
            return made_up(kind, rng)
        if kind == "string":
            return "ü" * bool(rng.integers(2)) + "x" * int(rng.integers(9))
        return int(rng.integers(_NUMBERS[kind])) if kind in _NUMBERS else float(np.float32(rng.normal()))

    message: dict[str, Any] = {}
    for line in DEFINITIONS[message_type].splitlines():
        kind, name = line.split()
        base, _, length = kind.removesuffix("]").partition("[")
        many = [one(base) for _ in range(int(length or rng.integers(4)))]
        message[name] = one(base) if base == kind else bytes(many) if base == "uint8" else many
    return message


def fields_of(message: Any) -> Any:
    """The same as dicts and lists."""
    if isinstance(message, list):
        return [fields_of(each) for each in message]
    names = getattr(message, "__slots__", None) or getattr(message, "__dict__", None)
    return {name: fields_of(getattr(message, name)) for name in names} if names else message


def library_decoder(message_type: str) -> Any:
    text = schema_text(message_type).encode()
    return DecoderFactory().decoder_for("cdr", Schema(id=1, data=text, encoding="ros2msg", name=schema_name(message_type)))


def big_endian(message_type: str, message: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> bytes:
    """The bytes of a machine that has the other order, by the library."""
    from mcap_ros2 import _dynamic

    with monkeypatch.context() as patch:
        patch.setattr(_dynamic, "CdrWriter", lambda output: _CdrWriter(output, kind=0))
        return serialize_dynamic(schema_name(message_type), schema_text(message_type))[message_type](message)


from mcap_ros2._cdr import CdrWriter as _CdrWriter  # noqa: E402


@pytest.mark.parametrize("message_type", DEFINITIONS)
def test_x(message_type: str, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(0)
    theirs = serialize_dynamic(schema_name(message_type), schema_text(message_type))[message_type]
    their_decoder = library_decoder(message_type)
    for k in range(20):
        message = made_up(message_type, rng)
        if k == 0: message = {}
        data = theirs(message)
        assert encoder(message_type)(message) == data
        for each in (data, big_endian(message_type, message, monkeypatch)):
            full = fields_of(their_decoder(each))
            assert fields_of(decoder(message_type)(each)) == full
            for end in range(len(each)):
                def tried(f):
                    try:
                        return fields_of(f(each[:end]))
                    except (struct.error, ValueError):
                        return "error"
                assert tried(their_decoder) == tried(decoder(message_type)), (end, len(each))
