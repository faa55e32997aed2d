"""Bytes of a message -> plain bytes -> its fields, as ROS 2 names them: CDR, ROS 1's, protobuf or JSON."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from types import SimpleNamespace
from typing import Any

import zstandard
from mcap.records import Schema

from sequences.errors import SequenceError
from sequences.files import parse_json
from sequences.recordings import foxglove, message_definitions
from sequences.recordings.message_definitions import is_known, message_types, schema_name

_ZSTD = b"\x28\xb5\x2f\xfd"  # no CDR begins so
_MAX_BYTES = 1 << 28


def encoding_of(message_type: str, encoding: str) -> str:
    """The encoding of `plain` bytes."""
    return "cdr" if encoding == "ros1" and is_known(message_type) else encoding


def plain(message_type: str, encoding: str, data: bytes) -> bytes:
    """Bytes of a message, unpacked, and as ROS 2 has them. Damaged ones raise any exception, by the library."""
    if encoding == "cdr" and data.startswith(_ZSTD):  # rosbag2's compression_mode `message`
        size = zstandard.frame_content_size(data)  # allocated whatever the limit; -1 where not stated
        if size > _MAX_BYTES:
            raise ValueError(f"states {size} bytes uncompressed, expected at most {_MAX_BYTES}")
        if size == -1:
            return zstandard.ZstdDecompressor().decompressobj().decompress(data)
        return zstandard.decompress(data)
    if encoding == "ros1" and is_known(message_type):
        return bytes(message_types().ros1_to_cdr(data, schema_name(message_type)))
    return data


@lru_cache(maxsize=256)
def decoder(message_type: str, encoding: str, definition: bytes) -> Callable[[bytes], Any]:
    """A function from the bytes of a message to its fields; only protobuf needs the file's definition of the type.

    Raises SequenceError where the encoding is not cdr, protobuf or json, or the definition is damaged.
    """
    fields: Callable[[bytes], Any]
    if encoding == "cdr":
        fields = message_definitions.decoder(message_type)
    elif encoding == "json":
        fields = _json_fields
    elif encoding == "protobuf":
        from mcap_protobuf.decoder import DecoderFactory  # few recordings need it, and every command would pay for it

        try:
            schema = Schema(id=1, data=definition, encoding="protobuf", name=message_type)
            decode = DecoderFactory().decoder_for("protobuf", schema)
        except Exception as error:  # a damaged definition raises undocumented exceptions
            raise SequenceError(f"its definition is no FileDescriptorSet of {message_type}: {error}") from error
        assert decode is not None
        fields = decode
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
