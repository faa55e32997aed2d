"""Settings in the metadata of a file of tensors: JSON -> configuration dataclasses, every value checked."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar, cast, get_args, get_origin, get_type_hints

from filtering.errors import VaporTrackError, quoted
from sequences.files import parse_json
from sequences.odometry_fit.result import OdometryFit
from vapor.tensor_files import CheckpointError

_KINDS = {
    bool: ("true or false", {bool}),
    int: ("a whole number", {int}),
    float: ("a number", {int, float}),
    dict: ("an object", {dict}),
}
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
    """A configuration dataclass from JSON, with every field and no other; fields may be dataclasses, or optional.

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
    hints = get_type_hints(kind)
    parsed = {field: _parsed(path, name, field, hints[field], value) for field, value in values.items()}
    try:
        return kind(**parsed)
    except (VaporTrackError, TypeError) as error:
        raise CheckpointError(f"{path}: {name} configuration: {error}") from error


def _parsed(path: Path, name: str, field: str, hint: Any, value: Any) -> Any:
    """A field's value from JSON by its type."""
    if type(None) in get_args(hint):
        if value is None:
            return None
        (hint,) = (each for each in get_args(hint) if each is not type(None))
    if hint is OdometryFit and isinstance(value, dict):
        try:
            return OdometryFit.from_dict(value)
        except VaporTrackError as error:
            raise CheckpointError(f"{path}: {name}.{field} configuration: {error}") from error
    if is_dataclass(hint):
        return parse_config(path, f"{name}.{field}", cast(type, hint), value)
    if get_origin(hint) is tuple:
        size = len(get_args(hint))
        if isinstance(value, list) and len(value) == size and all(type(each) in (int, float) for each in value):
            return tuple(map(float, value))
        wanted = f"{size} numbers"
    else:
        wanted, kinds = _KINDS.get(get_origin(hint) or hint, ("", {type(value)}))
        if type(value) in kinds:
            return value
    raise CheckpointError(f"{path}: {name} configuration has {field} {quoted(value)}, expected {wanted}")
