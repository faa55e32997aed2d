"""Where a model file is: at a path or a URL, or among those that ship with the package, by its name."""

from __future__ import annotations

from pathlib import Path

from vapor.storage import fetched, is_url, local_path
from vapor.tensor_files import CheckpointError

SHIPPED = Path(__file__).resolve().parents[1] / "models"
"""Folder of the models that ship."""


def find_model(name_or_path: str) -> Path:
    """The file of a model: a path, a URL, of which there is a copy here then, or the name of a model that ships.

    Raises:
        CheckpointError: neither a file nor a shipped model; lists those that ship.
    """
    path = fetched(local_path(name_or_path)) if is_url(name_or_path) else Path(name_or_path)
    if path.is_file():
        return path
    shipped = SHIPPED / f"{name_or_path}.safetensors"
    if path.name == name_or_path and shipped.is_file():
        return shipped
    names = ", ".join(sorted(p.stem for p in SHIPPED.glob("*.safetensors"))) or "none"
    raise CheckpointError(f"{name_or_path}: no such model file, expected one, or a model that ships: {names}")
