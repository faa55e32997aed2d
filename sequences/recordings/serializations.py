"""Bytes of a message -> its fields, as ROS 2 names them, whether it is encoded as CDR, protobuf or JSON."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from types import SimpleNamespace
from typing import Any

from mcap.records import Schema

from sequences.errors import SequenceError
from sequences.files.structured import parse_json
from sequences.recordings import foxglove, message_definitions


@lru_cache(maxsize=256)
def decoder(message_type: str, encoding: str, definition: bytes) -> Callable[[bytes], SimpleNamespace]:
    """A function from the bytes of a message to its fields.

    Args:
        message_type: Its type as the file names it, without ROS 2's `/msg`.
        encoding: How it is serialized: "cdr", "protobuf" or "json".
        definition: What the file says of its type: only protobuf needs it, a FileDescriptorSet.

    Raises:
        SequenceError: the encoding is none of these, or the type's definition is damaged.
    """
    fields: Callable[[bytes], Any]
    if encoding == "cdr":
        fields = message_definitions.decoder(message_type)
    elif encoding == "json":
        fields = _json_fields
    elif encoding == "protobuf":
        fields = _protobuf_decoder(message_type, definition)
    else:
        raise SequenceError(f"encoding {encoding!r} is not known, expected cdr, protobuf or json")
    convert = foxglove.converter(message_type)
    return lambda data: convert(fields(data))


def _json_fields(data: bytes) -> SimpleNamespace:
    fields = _with_attributes(parse_json(data, "no JSON"))
    if not isinstance(fields, SimpleNamespace):
        raise SequenceError("no JSON object")
    return fields


def _with_attributes(value: Any) -> Any:
    if isinstance(value, dict):
        return SimpleNamespace(**{name: _with_attributes(each) for name, each in value.items()})
    return [_with_attributes(each) for each in value] if isinstance(value, list) else value


def _protobuf_decoder(message_type: str, definition: bytes) -> Callable[[bytes], Any]:
    # Few recordings need it, and every command would pay for it.
    from mcap_protobuf.decoder import DecoderFactory

    schema = Schema(id=1, data=definition, encoding="protobuf", name=message_type)
    try:
        decode = DecoderFactory().decoder_for("protobuf", schema)
    except Exception as error:  # what a damaged definition raises is not documented
        raise SequenceError(f"its definition is no FileDescriptorSet of {message_type}: {error}") from error
    assert decode is not None
    return decode
