"""Exported models taken apart and put together, so that tests can change one part; the graph need not be one."""

import base64
import hashlib
import json
import struct
from collections.abc import Callable, Iterable
from pathlib import Path

from safetensors.numpy import load

from vapor.checkpoints.checkpoint import ModelDescription
from vapor.engines import onnx_file
from vapor.engines.onnx_file import ARRAYS, CONFIG, GRAPH, add_description
from vapor.tensor_files import as_bytes

GRAPH_BYTES = b"\x08\x08" + b"\x3a\x05\x12\x03abc" + b"\x42\x02\x10\x11"
"""IR version 8, a graph that is but a name, operators of version 17."""

Entries = list[tuple[bytes, bytes]]
"""Names and texts of the metadata, in their order."""


def write_export(path: Path, model: ModelDescription, graph: bytes = GRAPH_BYTES) -> Path:
    path.write_bytes(graph)
    add_description(path, model)
    return path


def field(number: int, content: bytes) -> bytes:
    """A field of a protocol buffer that holds bytes; its length in as many bytes as it needs."""
    length, size = b"", len(content)
    while size > 127:
        length, size = length + bytes([size & 127 | 128]), size >> 7
    return bytes([number << 3 | 2]) + length + bytes([size]) + content


def put_together(graph: bytes, entries: Iterable[tuple[bytes, bytes]]) -> bytes:
    return graph + b"".join(field(14, field(1, name) + field(2, text)) for name, text in entries)


def take_apart(content: bytes) -> tuple[bytes, Entries]:
    graph, entries = onnx_file._parts(content)
    return bytes(graph), [(name.encode(), text.encode()) for name, text in entries.items()]


def with_digest(graph: bytes, entries: Entries) -> bytes:
    digest = hashlib.sha256(graph).hexdigest().encode()
    return put_together(graph, [(name, digest if name == GRAPH.encode() else text) for name, text in entries])


def with_arrays(content: bytes, change: Callable[[bytes], bytes]) -> bytes:
    """An exported model whose description, the content of a safetensors file, was changed."""
    graph, entries = take_apart(content)
    changed = base64.b64encode(change(base64.b64decode(dict(entries)[ARRAYS.encode()])))
    return put_together(graph, [(name, changed if name == ARRAYS.encode() else text) for name, text in entries])


def with_config(content: bytes, config: str) -> bytes:
    """An exported model of another configuration, under a checksum that fits."""

    def other(arrays: bytes) -> bytes:
        return as_bytes(load(arrays), metadata_of(arrays) | {"config": config})

    graph, entries = take_apart(with_arrays(content, other))
    return put_together(graph, [(name, config.encode() if name == CONFIG.encode() else text) for name, text in entries])


def metadata_of(arrays: bytes) -> dict[str, str]:
    (length,) = struct.unpack("<Q", arrays[:8])
    return json.loads(arrays[8 : 8 + length])["__metadata__"]
