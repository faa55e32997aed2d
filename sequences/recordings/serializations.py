"""Bytes of a message -> plain bytes -> its fields, as ROS 2 names them: CDR, ROS 1's, protobuf or JSON."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, lru_cache
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import zstandard
from mcap.records import Schema

from sequences.errors import SequenceError
from sequences.files import parse_json
from sequences.recordings import foxglove, message_definitions
from sequences.recordings.message_definitions import DEFINITIONS, schema_name, schema_text

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore


_ZSTD = b"\x28\xb5\x2f\xfd"  # no CDR begins so
_MAX_BYTES = 1 << 28


def encoding_of(message_type: str, encoding: str) -> str:
    """How messages are serialized once they are plain."""
    return "cdr" if encoding == "ros1" and message_type in DEFINITIONS else encoding


def plain(message_type: str, encoding: str, data: bytes) -> bytes:
    """Bytes of a message, plain.

    Args:
        message_type: Its type, without ROS 2's `/msg`.
        encoding: How the file says that it is serialized.
        data: Its bytes in the file.

    Raises:
        Exception: they are damaged; what it is depends on the library.
    """
    if encoding == "cdr" and data.startswith(_ZSTD):  # rosbag2's compression_mode `message`
        return _unpacked(data)
    if encoding == "ros1" and message_type in DEFINITIONS:
        return bytes(_ros1().ros1_to_cdr(data, schema_name(message_type)))
    return data


def _unpacked(data: bytes) -> bytes:
    size = zstandard.frame_content_size(data)  # what is allocated, whatever limit is given; -1 where not stated
    if size > _MAX_BYTES:
        raise ValueError(f"states {size} bytes uncompressed, expected at most {_MAX_BYTES}")
    unpacked = zstandard.ZstdDecompressor().decompressobj().decompress(data) if size == -1 else None
    return zstandard.decompress(data) if unpacked is None else unpacked


@cache
def _ros1() -> Typestore:
    """The types that are read, by our own definitions: what a file says of its types is not run."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore  # few recordings need it

    store = get_typestore(Stores.EMPTY)
    for name in DEFINITIONS:
        new = get_types_from_msg(schema_text(name), schema_name(name))
        store.register({known: kind for known, kind in new.items() if known not in store.fielddefs})
    return store


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
