"""Models as ONNX files: the network as a graph, all else as metadata; read without the package onnx, and without torch.

An ONNX file is a protocol buffer of numbered fields (github.com/onnx/onnx, onnx/onnx.proto). The fields that
describe the model are few and separate from the graph, which is skipped.
"""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterator
from pathlib import Path

from vapor.checkpoints.checkpoint import ModelDescription
from vapor.checkpoints.file_format import (
    description_arrays,
    description_metadata,
    parse_description,
    parse_stored_config,
)
from vapor.checkpoints.stored_tensors import MEMORY
from vapor.tensor_files import CheckpointError, as_bytes, parse_stored

CONFIG, ARRAYS, GRAPH = "vapor-track config", "vapor-track arrays", "vapor-track graph_sha256"
"""Names of the metadata: settings as JSON, for all to read; all of the description, as a safetensors file in base64;
SHA-256 of the content before the metadata, the graph and the version of its operators."""
_METADATA_PROPS, _KEY, _VALUE = 14, 1, 2  # numbers of fields
_BYTES_BY_WIRE = {1: 8, 5: 4}  # lengths of fields of fixed length, by their type
_MOST_BYTES = 2**31  # of a protocol buffer
_MOST_FIELDS = 1000  # of a message that is read here; an exported model has nine
_MOST_BYTES_OF_VARINT = 10


def add_description(path: Path, model: ModelDescription) -> None:
    """Append the description of a model to an ONNX file, and the graph's digest."""
    metadata, arrays = description_metadata(model), description_arrays(model)
    if (poses := model.memory_poses) is not None:
        arrays |= {f"{MEMORY}rotation": poses.rotation, f"{MEMORY}translation": poses.translation}
    content = path.read_bytes()
    encoded = base64.b64encode(as_bytes(arrays, metadata)).decode()
    entries = {CONFIG: metadata["config"], ARRAYS: encoded, GRAPH: hashlib.sha256(content).hexdigest()}
    path.write_bytes(content + b"".join(_entry(name, text) for name, text in entries.items()))


def describe_onnx(path: Path) -> ModelDescription:
    """The description in an exported model.

    Raises:
        CheckpointError: no such file, no ONNX file, one that `vapor-track export` did not write, or a damaged one.
    """
    content = _read(path)
    try:
        graph, entries = _parts(content)
        decoded = base64.b64decode(entries[ARRAYS], validate=True)
    except (ValueError, KeyError) as error:
        raise CheckpointError(f"{path}: no ONNX file of `vapor-track export`, or cut off, expected one") from error
    if entries.get(GRAPH) != hashlib.sha256(graph).hexdigest():
        raise CheckpointError(f"{path}: damaged: its graph does not match its digest, expected the file as written")
    stored, tensors = parse_stored(path, decoded)
    if entries.get(CONFIG) != stored.get("config"):
        raise CheckpointError(
            f"{path}: damaged: {CONFIG!r} in its metadata differs from {ARRAYS!r}, expected the file as written"
        )
    config = parse_stored_config(path, stored)
    return parse_description(path, config, tensors, hashlib.sha256(content).hexdigest())


def is_exported(path: Path) -> bool:
    """Whether a file is a model that `vapor-track export` wrote."""
    try:
        return ARRAYS in _parts(_read(path))[1]
    except (CheckpointError, ValueError):
        return False


def _read(path: Path) -> bytes:
    try:
        if not path.is_file():
            raise CheckpointError(f"{path}: no such file, expected an ONNX file of `vapor-track export`")
        size = path.stat().st_size
        if size > _MOST_BYTES:
            raise CheckpointError(f"{path}: has {size} bytes, expected an ONNX file, which has {_MOST_BYTES} at most")
        return path.read_bytes()
    except OSError as error:
        raise CheckpointError(f"{path}: cannot be read ({error.strerror}), expected an ONNX file") from error


def _parts(content: bytes) -> tuple[memoryview, dict[str, str]]:
    """An ONNX file's graph and all else before its metadata, and the names and texts of the metadata.

    Raises:
        ValueError: the content is no such file, or one whose metadata have a name twice.
    """
    view, metadata, end_of_graph = memoryview(content), {}, 0
    for number, value, end in _fields(view):
        if number == _METADATA_PROPS:
            entry = {part: bytes(text).decode() for part, text, _ in _fields(value)}
            name = entry.get(_KEY, "")
            if name in metadata:
                raise ValueError(f"metadata have {name} twice")
            metadata[name] = entry.get(_VALUE, "")
        else:  # also after the metadata, where a second graph would be merged with the first: then no digest fits
            end_of_graph = end
    return view[:end_of_graph], metadata


def _fields(content: memoryview) -> Iterator[tuple[int, memoryview, int]]:
    """Numbers and contents of a message's fields, and where they end; fields that are numbers have no content.

    Raises:
        ValueError: no message, or one of very many fields.
    """
    position = fields = 0
    while position < len(content):
        tag, position = _varint(content, position)
        number, wire = tag >> 3, tag & 7
        if wire == 0:
            _, end = _varint(content, position)
            position = end
        elif wire == 2:
            length, position = _varint(content, position)
            end = position + length
        elif wire in _BYTES_BY_WIRE:
            end = position + _BYTES_BY_WIRE[wire]
        else:
            raise ValueError(f"field {number} is of type {wire}")
        fields += 1
        if end > len(content) or fields > _MOST_FIELDS:
            raise ValueError(f"field {number} ends after the file, or is one of more than {_MOST_FIELDS}")
        yield number, content[position:end], end
        position = end


def _varint(content: memoryview, position: int) -> tuple[int, int]:
    """A number, seven bits a byte, the lowest first; and where it ends."""
    value = 0
    for count, byte in enumerate(content[position : position + _MOST_BYTES_OF_VARINT]):
        value |= (byte & 127) << 7 * count
        if byte < 128:
            return value, position + count + 1
    raise ValueError(f"a number does not end within {_MOST_BYTES_OF_VARINT} bytes, or the file")


def _entry(name: str, text: str) -> bytes:
    return _field(_METADATA_PROPS, _field(_KEY, name.encode()) + _field(_VALUE, text.encode()))


def _field(number: int, content: bytes) -> bytes:
    return _as_varint(number << 3 | 2) + _as_varint(len(content)) + content


def _as_varint(value: int) -> bytes:
    return bytes([value]) if value < 128 else bytes([value & 127 | 128]) + _as_varint(value >> 7)
