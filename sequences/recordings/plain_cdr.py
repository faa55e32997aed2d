"""Bytes of a message as a file has them -> plain CDR: those compressed one by one, and those of ROS 1."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

import zstandard

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
