"""Files of tensors: safetensors with a checksum over all their content, for models and states of training runs."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from filtering.errors import VaporTrackError
from sequences.atomic import atomic_output

CHECKSUM = "content_sha256"
"""Name of the checksum in the metadata; files written before there were any lack it."""
_OURS = "vapor-track "  # what `format` begins with in our own files, whose metadata have these names and no others
_METADATA = {"format", "version", "config", CHECKSUM}


class CheckpointError(VaporTrackError):
    """A model file, or the state of a training run, cannot be used."""


def write_safetensors(path: Path, tensors: Mapping[str, Tensor], metadata: Mapping[str, str]) -> None:
    """Write a file with its checksum, complete or not at all.

    Args:
        path: A file name, usually *.safetensors.
        tensors: Any, on the CPU.
        metadata: Its other content; a checksum in it is that of another file, and left out.

    Raises:
        SequenceError: the folder is missing, or cannot be written to.
    """
    tensors = {name: value.contiguous() for name, value in tensors.items()}
    stated = {**metadata, CHECKSUM: content_sha256(tensors, metadata)}
    with atomic_output(path) as temporary:
        # The library's own writing to a file would leave it readable for its owner only.
        temporary.write_bytes(save(tensors, stated))


def read_safetensors(path: Path) -> tuple[dict[str, str], dict[str, Tensor]]:
    """Metadata and tensors of a safetensors file, on the CPU, once its checksum was found to fit.

    A file without a checksum is taken as it is: `CHECKSUM` is in the metadata where there is one.

    Raises:
        CheckpointError: no such file, no safetensors file, or a damaged one.
    """
    if not path.is_file():
        raise CheckpointError(f"{path}: no such file, expected a safetensors file")
    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (OSError, SafetensorError, ValueError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise CheckpointError(f"{path}: cannot be read ({reason}), expected a safetensors file") from error
    # One flipped bit can take the checksum its name: then there is another one that no file of ours has.
    renamed = metadata.get("format", "").startswith(_OURS) and not metadata.keys() <= _METADATA
    if renamed or metadata.get(CHECKSUM) not in (None, content_sha256(tensors, metadata)):
        raise CheckpointError(
            f"{path}: damaged: its tensors or settings do not match its checksum, expected the file as it was written"
        )
    return metadata, tensors


def format_of(path: Path) -> str | None:
    """What a safetensors file says that it is; None where it says nothing, or is none."""
    try:
        with safe_open(path, framework="pt") as file:
            return (file.metadata() or {}).get("format")
    except (OSError, SafetensorError, ValueError):
        return None


def content_sha256(tensors: Mapping[str, Tensor], metadata: Mapping[str, str]) -> str:
    """SHA-256 of names, types, shapes and bytes of all tensors, and of all metadata but the checksum itself."""
    said = {name: value for name, value in metadata.items() if name != CHECKSUM}
    digest = hashlib.sha256(json.dumps(said, sort_keys=True).encode())
    for name in sorted(tensors):
        tensor = tensors[name]
        digest.update(json.dumps([name, str(tensor.dtype), list(tensor.shape)]).encode())
        digest.update(tensor.reshape(-1).view(torch.uint8).numpy().data)
    return digest.hexdigest()
