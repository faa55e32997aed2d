"""Bytes of a message -> plain bytes -> its fields, as ROS 2 names them: CDR, ROS 1's, protobuf or JSON."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, lru_cache
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import zstandard
from mcap.records import Schema

from sequences.errors import SequenceError
from sequences.files.structured import parse_json
from sequences.recordings import foxglove, message_definitions
from sequences.recordings.message_definitions import DEFINITIONS, schema_name, schema_text

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore


_ZSTD = b"\x28\xb5\x2f\xfd"  # no CDR begins so
_MAX_BYTES = 1 << 28


def encoding_of(message_type: str, encoding: str) -> str:
    """The encoding of `plain` bytes."""
    return "cdr" if encoding == "ros1" and message_type in DEFINITIONS else encoding


def plain(message_type: str, encoding: str, data: bytes) -> bytes:
    """Bytes of a message, unpacked, and as ROS 2 has them. Damaged ones raise any exception, by the library."""
    if encoding == "cdr" and data.startswith(_ZSTD):  # rosbag2's compression_mode `message`
        size = zstandard.frame_content_size(data)  # allocated whatever the limit; -1 where not stated
        if size > _MAX_BYTES:
            raise ValueError(f"states {size} bytes uncompressed, expected at most {_MAX_BYTES}")
        if size == -1:
            return zstandard.ZstdDecompressor().decompressobj().decompress(data)
        return zstandard.decompress(data)
    if encoding == "ros1" and message_type in DEFINITIONS:
        return bytes(_ros1().ros1_to_cdr(data, schema_name(message_type)))
    return data


@cache
def _ros1() -> Typestore:
    """The types that are read, by our own definitions: those of files are not run."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore  # few recordings need it

    store = get_typestore(Stores.EMPTY)
    for name in DEFINITIONS:
        new = get_types_from_msg(schema_text(name), schema_name(name))
        store.register({known: kind for known, kind in new.items() if known not in store.fielddefs})
    return store


@lru_cache(maxsize=256)
def decoder(message_type: str, encoding: str, definition: bytes) -> Callable[[bytes], SimpleNamespace]:
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
