"""Compiled networks, kept beside the model: in a hidden folder, or in the user's cache where nothing can be written.

What cannot be used (damaged, of another version, of another model) is as good as absent.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import os
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from filtering.errors import VaporTrackError
from sequences.atomic import CACHE
from vapor.tensor_files import CheckpointError, read_stored, write_arrays

_FORMAT = "vapor-track compiled network"
_VERSION = "1"
_BLOB = "blob"


@dataclass(frozen=True)
class Variant:
    """What a compiled network depends on.

    Attributes:
        network: Digest of the network.
        described: Whether it gives a description of the image.
        precision: Of its arithmetic.
        processor: That it was compiled for.
        openvino: Version of OpenVINO.
        package: Version of this package.
    """

    network: str
    described: bool
    precision: str
    processor: str
    openvino: str
    package: str = importlib.metadata.version("vapor-track")

    @property
    def name(self) -> str:
        """What its file is called after the model's: first what all variants of a model share while they are valid."""
        return f"{_digest(self.network, self.openvino, self.package)}-{_digest(*map(str, asdict(self).values()))}"


@dataclass(frozen=True)
class Compiled:
    """A compiled network.

    Attributes:
        blob: What the engine makes it from.
        faster: Whether it was faster than torch when it was compiled; None where torch was not asked.
    """

    blob: bytes
    faster: bool | None


def read_compiled(model: Path, variant: Variant) -> Compiled | None:
    """The compiled network of a model file; None where there is none that can be used."""
    for folder in _folders(model):
        file = folder / f"{model.name}-{variant.name}"
        with suppress(CheckpointError, ValueError, KeyError, TypeError):
            metadata, tensors = read_stored(file)
            config = json.loads(metadata["config"])
            if (metadata["format"], metadata["version"], config["variant"]) == (_FORMAT, _VERSION, asdict(variant)):
                return Compiled(bytes(tensors[_BLOB].data), config["faster"])
    return None


def write_compiled(model: Path, variant: Variant, compiled: Compiled) -> bool:
    """Keep a compiled network, in the place of those of the same model that are not valid any more; whether it could.

    The file appears when it is complete; of two processes the last one's stays.
    """
    config = {"variant": asdict(variant), "faster": compiled.faster}
    metadata = {"format": _FORMAT, "version": _VERSION, "config": json.dumps(config)}
    for folder in _folders(model):
        try:
            folder.mkdir(parents=folder != _beside(model), exist_ok=True)
            ignore = folder / ".gitignore"
            if not ignore.exists():
                ignore.write_text("*\n", encoding="utf-8")
            file = folder / f"{model.name}-{variant.name}"
            write_arrays(file, {_BLOB: np.frombuffer(compiled.blob, np.uint8)}, metadata)
        except (OSError, VaporTrackError):
            continue
        _remove_invalid(file)
        return True
    return False


def can_be_kept(model: Path) -> bool:
    """Whether compiled networks of a model file can be kept anywhere, as far as that is known before."""
    return any(os.access(_nearest(folder), os.W_OK) for folder in _folders(model))


def _folders(model: Path) -> tuple[Path, Path]:
    """Where compiled networks of a model may be: beside it, and in the user's cache by where the model is."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return _beside(model), cache / "vapor-track" / _digest(str(model.parent.resolve()))


def _beside(model: Path) -> Path:
    return model.parent / CACHE


def _nearest(folder: Path) -> Path:
    """The folder, or the first of those above it that exists."""
    return folder if folder.exists() else _nearest(folder.parent)


def _remove_invalid(file: Path) -> None:
    """Remove compiled networks of the same model file that are of another network or version."""
    valid, _, _ = file.name.rpartition("-")
    model, _, _ = valid.rpartition("-")
    for other in file.parent.glob("*"):
        named, _, _ = other.name.rpartition("-")
        if named != valid and named.rpartition("-")[0] == model:
            with suppress(OSError):
                other.unlink()


def _digest(*texts: str) -> str:
    return hashlib.sha256("\n".join(texts).encode()).hexdigest()[:12]
