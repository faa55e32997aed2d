"""Settings in the metadata of a file of tensors: JSON -> configuration dataclasses, every value checked."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar

from filtering.errors import VaporTrackError, quoted
from sequences.files import parse_json
from sequences.frame import Camera
from vapor.regressors.scene_box import SceneBox
from vapor.tensor_files import CheckpointError

_KINDS = {bool: ("true or false", {bool}), int: ("a whole number", {int}), float: ("a number", {int, float})}

Config = TypeVar("Config")


def parse_metadata(path: Path, text: str | None) -> dict[str, Any]:
    """The JSON object in a file's metadata.

    Raises:
        CheckpointError: absent, or no JSON object.
    """
    try:
        value = parse_json(text or "null", f"{path}: configuration in its metadata")
    except VaporTrackError as error:
        raise CheckpointError(str(error)) from error
    if not isinstance(value, dict):
        raise CheckpointError(f"{path}: configuration in its metadata is {quoted(value)}, expected a JSON object")
    return value


def parse_config(path: Path, name: str, kind: type[Config], values: Any) -> Config:
    """A configuration dataclass from JSON, every field given and no other.

    Raises:
        CheckpointError: missing or surplus fields, or values that the dataclass refuses.
    """
    expected = {f.name for f in fields(kind)}  # pyright: ignore[reportArgumentType]
    found = set(values) if isinstance(values, dict) else set()
    if found != expected:
        raise CheckpointError(
            f"{path}: {name} configuration lacks {quoted(sorted(expected - found))} and has surplus"
            f" {quoted(sorted(found - expected))}, expected {', '.join(sorted(expected))}"
        )
    for f in fields(kind):  # pyright: ignore[reportArgumentType]
        what, kinds = _KINDS.get(type(f.default), ("", None))
        if kinds and type(values[f.name]) not in kinds:
            raise CheckpointError(
                f"{path}: {name} configuration has {f.name} {quoted(values[f.name])}, expected {what}"
            )
    try:
        return kind(**values)
    except (VaporTrackError, TypeError) as error:
        raise CheckpointError(f"{path}: {name} configuration: {error}") from error


def parse_box(path: Path, box: Any) -> SceneBox:
    """A scene box from JSON, whose lists become the tuples that it has.

    Raises:
        CheckpointError: missing, surplus or unusable values.
    """
    if not isinstance(box, dict):
        return parse_config(path, "box", SceneBox, box)  # which says what is wrong
    for name, values in box.items():
        if not (isinstance(values, list) and len(values) == 3 and all(isinstance(v, int | float) for v in values)):
            raise CheckpointError(f"{path}: box configuration has {name} {quoted(values)}, expected three numbers")
    triples = {name: (float(x), float(y), float(z)) for name, (x, y, z) in box.items()}
    return parse_config(path, "box", SceneBox, triples)


def parse_camera(path: Path, values: Any) -> Camera | None:
    """A camera from JSON; None where none was known.

    Raises:
        CheckpointError: missing, surplus or unusable values.
    """
    if values is None:
        return None
    for name, value in values.items() if isinstance(values, dict) else ():
        if type(value) not in ((int,) if name in ("width", "height") else (int, float)):
            raise CheckpointError(f"{path}: camera configuration has {name} {quoted(value)}, expected a number")
    return parse_config(path, "camera", Camera, values)
