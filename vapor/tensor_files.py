"""Safetensors files with a checksum over all their content, for models and states of training runs."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from safetensors import SafetensorError, deserialize, safe_open
from safetensors.numpy import save

from filtering.errors import VaporTrackError
from sequences.atomic import atomic_output

if TYPE_CHECKING:
    from torch import Tensor

CHECKSUM = "content_sha256"
"""Name of the checksum in the metadata."""
_OURS = "vapor-track "  # what `format` begins with in our own files, which have a checksum
_TYPES: Mapping[str, str] = MappingProxyType(
    {
        **{f"F{bits}": f"float{bits}" for bits in (16, 32, 64)},
        **{f"I{bits}": f"int{bits}" for bits in (8, 16, 32, 64)},
        **{f"U{bits}": f"uint{bits}" for bits in (8, 16, 32, 64)},
        "BF16": "bfloat16",
        "BOOL": "bool",
    }
)
"""Names of types in safetensors -> in torch."""
Stored: TypeAlias = "StoredTensor | np.ndarray | Tensor"
FLOATS = "float16", "bfloat16", "float32", "float64"


class CheckpointError(VaporTrackError):
    """A model file, or the state of a training run, cannot be used."""


@dataclass(frozen=True)
class StoredTensor:
    """A tensor of a file, without torch: type by torch's name, such as float32, and bytes row by row."""

    dtype: str
    shape: tuple[int, ...]
    data: bytes | bytearray

    @staticmethod
    def of(value: Stored) -> StoredTensor:
        """A tensor of torch, on any device, or an array."""
        if isinstance(value, StoredTensor):
            return value
        array = value if isinstance(value, np.ndarray) else value.detach().cpu().numpy()
        return StoredTensor(array.dtype.name, array.shape, array.tobytes())

    def array(self) -> np.ndarray:
        """A copy as an array; bfloat16, which numpy lacks, becomes float32."""
        if self.dtype == "bfloat16":
            wide = np.frombuffer(self.data, np.uint16).astype(np.uint32) << 16
            return wide.view(np.float32).reshape(self.shape)
        return np.frombuffer(self.data, self.dtype).reshape(self.shape).copy()

    def tensor(self) -> Tensor:
        """A copy as a tensor of torch on the CPU."""
        import torch

        if not self.data:
            return torch.empty(self.shape, dtype=getattr(torch, self.dtype))
        flat = torch.frombuffer(bytearray(self.data), dtype=torch.uint8).view(getattr(torch, self.dtype))
        return flat.reshape(self.shape)


def write_safetensors(path: Path, tensors: Mapping[str, Stored], metadata: Mapping[str, str]) -> None:
    """Write tensors and arrays with a checksum, complete or not at all; a checksum in the metadata is replaced.

    Raises:
        SequenceError: the folder is missing, or cannot be written to.
    """
    content = as_bytes(tensors, metadata)
    with atomic_output(path) as temporary:
        # The library's own writing to a file would leave it readable for its owner only.
        temporary.write_bytes(content)


def as_bytes(tensors: Mapping[str, Stored], metadata: Mapping[str, str]) -> bytes:
    """The content of a file of tensors and arrays, with its checksum."""
    stored = {name: StoredTensor.of(value) for name, value in tensors.items()}
    arrays = {name: value.array() for name, value in stored.items()}
    return save(arrays, {**metadata, CHECKSUM: content_sha256(stored, metadata)})


def read_safetensors(path: Path) -> tuple[dict[str, str], dict[str, Tensor]]:
    """Metadata and tensors of a safetensors file, on the CPU; a file of others needs no checksum.

    Raises:
        CheckpointError: no such file, no safetensors file, or a damaged one.
    """
    metadata, tensors = read_stored(path)
    return metadata, {name: value.tensor() for name, value in tensors.items()}


def read_stored(path: Path) -> tuple[dict[str, str], dict[str, StoredTensor]]:
    """The same without torch."""
    if not path.is_file():
        raise CheckpointError(f"{path}: no such file, expected a safetensors file")
    try:
        content = path.read_bytes()
    except OSError as error:
        raise CheckpointError(f"{path}: cannot be read ({error}), expected a safetensors file") from error
    return parse_stored(path, content)


def parse_stored(path: Path, content: bytes) -> tuple[dict[str, str], dict[str, StoredTensor]]:
    """The same of the content of a file; its path is for messages."""
    try:
        stored = deserialize(content)
        header = json.loads(content[8 : 8 + int.from_bytes(content[:8], "little")])
    except (SafetensorError, ValueError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise CheckpointError(f"{path}: cannot be read ({reason}), expected a safetensors file") from error
    metadata: dict[str, str] = header.get("__metadata__") or {}
    tensors: dict[str, StoredTensor] = {}
    for name, part in stored:
        if part["dtype"] not in _TYPES:
            raise CheckpointError(f"{path}: tensor {name} is of {part['dtype']}, expected one of {', '.join(_TYPES)}")
        tensors[name] = StoredTensor(_TYPES[part["dtype"]], tuple(part["shape"]), part["data"])
    has_checksum = CHECKSUM in metadata or metadata.get("format", "").startswith(_OURS)
    if has_checksum and metadata.get(CHECKSUM) != content_sha256(tensors, metadata):
        raise CheckpointError(
            f"{path}: damaged: its tensors or settings do not match its checksum, expected the file as it was written"
        )
    return metadata, tensors


def format_of(path: Path) -> str | None:
    """The `format` in the metadata of a safetensors file; None without one, or for another file."""
    try:
        with safe_open(path, framework="np") as file:
            return (file.metadata() or {}).get("format")
    except (OSError, SafetensorError, ValueError):
        return None


def content_sha256(tensors: Mapping[str, Stored], metadata: Mapping[str, str]) -> str:
    """SHA-256 of names, types, shapes and bytes of all tensors, and of all metadata but the checksum itself."""
    others = {name: value for name, value in metadata.items() if name != CHECKSUM}
    digest = hashlib.sha256(json.dumps(others, sort_keys=True).encode())
    for name in sorted(tensors):
        tensor = StoredTensor.of(tensors[name])
        digest.update(json.dumps([name, f"torch.{tensor.dtype}", list(tensor.shape)]).encode())
        digest.update(tensor.data)
    return digest.hexdigest()
