"""Models as ONNX files: the network as a graph, all else as metadata; read without the package onnx, and without torch.

An ONNX file is a protocol buffer of numbered fields (github.com/onnx/onnx, onnx/onnx.proto). Those that tell of the
model are few and come apart from the graph, which is skipped.
"""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterator
from pathlib import Path

from vapor.checkpoints.description import ModelDescription
from vapor.checkpoints.file_format import shapes_beside_weights
from vapor.checkpoints.stored_description import (
    description_arrays,
    description_metadata,
    parse_description,
    parse_stored_config,
)
from vapor.checkpoints.stored_tensors import MEMORY_ROTATION, MEMORY_TRANSLATION, check_tensors
from vapor.tensor_files import CheckpointError, arrays_as_bytes, parse_stored

SUFFIX = ".onnx"
CONFIG, ARRAYS, GRAPH = "vapor-track config", "vapor-track arrays", "vapor-track graph_sha256"
"""Names of the metadata: settings as JSON, for all to read; all of the description, as a safetensors file in base64;
SHA-256 of the graph."""
_GRAPH, _METADATA_PROPS, _KEY, _VALUE = 7, 14, 1, 2  # numbers of fields
_BYTES_BY_WIRE = {1: 8, 5: 4}  # lengths of fields of fixed length, by their type


def is_onnx(path: Path) -> bool:
    """Whether a model is an exported one, by the name of its file."""
    return path.suffix.lower() == SUFFIX


def add_description(path: Path, model: ModelDescription) -> None:
    """Append to an ONNX file what a model says of itself beside its graph, and the graph's digest."""
    metadata, arrays = description_metadata(model), description_arrays(model)
    if (poses := model.memory_poses) is not None:
        arrays |= {MEMORY_ROTATION: poses.rotation, MEMORY_TRANSLATION: poses.translation}
    content = path.read_bytes()
    said = base64.b64encode(arrays_as_bytes(arrays, metadata)).decode()
    for name, text in ((CONFIG, metadata["config"]), (ARRAYS, said), (GRAPH, _graph_sha256(content))):
        entry = _field(_KEY, name.encode()) + _field(_VALUE, text.encode())
        content += _field(_METADATA_PROPS, entry)
    path.write_bytes(content)


def describe_onnx(path: Path) -> ModelDescription:
    """What an exported model says of itself.

    Raises:
        CheckpointError: no such file, no ONNX file, one that `vapor-track export` did not write, or a damaged one.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise CheckpointError(f"{path}: cannot be read ({error.strerror}), expected an ONNX file") from error
    try:
        metadata = dict(_metadata(content))
        said, graph = base64.b64decode(metadata[ARRAYS], validate=True), metadata[GRAPH]
    except (ValueError, KeyError, IndexError) as error:
        raise CheckpointError(f"{path}: no ONNX file of `vapor-track export`, expected one") from error
    if graph != _graph_sha256(content):
        raise CheckpointError(f"{path}: damaged: its graph does not match its digest, expected the file as written")
    stored, tensors = parse_stored(path, said)
    config = parse_stored_config(path, stored)
    check_tensors(path, tensors, shapes_beside_weights(config, tensors))
    return parse_description(path, config, tensors, hashlib.sha256(content).hexdigest())


def is_exported(path: Path) -> bool:
    """Whether a file is a model that `vapor-track export` wrote."""
    try:
        return ARRAYS in dict(_metadata(path.read_bytes()))
    except (OSError, ValueError, IndexError):
        return False


def _metadata(content: bytes) -> Iterator[tuple[str, str]]:
    """The names and texts in an ONNX file's `metadata_props`.

    Raises:
        ValueError, IndexError: the content is no such file.
    """
    for number, value in _fields(memoryview(content)):
        if number == _METADATA_PROPS:
            entry = {part: bytes(text).decode() for part, text in _fields(value)}
            yield entry.get(_KEY, ""), entry.get(_VALUE, "")


def _graph_sha256(content: bytes) -> str:
    graphs = (value for number, value in _fields(memoryview(content)) if number == _GRAPH)
    return hashlib.sha256(b"".join(graphs)).hexdigest()


def _fields(content: memoryview) -> Iterator[tuple[int, memoryview]]:
    """Numbers and contents of a message's fields; those that are numbers have none."""
    position = 0
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
        if end > len(content):
            raise ValueError(f"field {number} ends after the file")
        yield number, content[position:end]
        position = end


def _varint(content: memoryview, position: int) -> tuple[int, int]:
    """A number, seven bits a byte, the lowest first; and where it ends."""
    value = shift = 0
    while True:
        byte = content[position]
        value |= (byte & 127) << shift
        position, shift = position + 1, shift + 7
        if byte < 128:
            return value, position


def _field(number: int, content: bytes) -> bytes:
    """A message's field of bytes."""
    return _as_varint(number << 3 | 2) + _as_varint(len(content)) + content


def _as_varint(value: int) -> bytes:
    return bytes([value]) if value < 128 else bytes([value & 127 | 128]) + _as_varint(value >> 7)
