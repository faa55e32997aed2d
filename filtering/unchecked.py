"""Changed copies of values that were checked when they were made."""

from __future__ import annotations

from typing import Any, TypeVar

Value = TypeVar("Value")


def unchecked_replace(value: Value, **changes: Any) -> Value:
    """As `dataclasses.replace`, for changes that keep a frozen dataclass valid: its checks are not run again."""
    copy, state = object.__new__(type(value)), {**vars(value), **changes}
    fields: dict[str, Any] = type(value).__dataclass_fields__  # pyright: ignore[reportAttributeAccessIssue]
    if len(state) > len(fields):  # cached properties, which may be others now
        state = {name: state[name] for name in fields}
    vars(copy).update(state)
    return copy
