"""Changed copies of values that were checked when they were made."""

from __future__ import annotations

from typing import Any, TypeVar

Value = TypeVar("Value")


def unchecked_replace(value: Value, **changes: Any) -> Value:
    """As `dataclasses.replace`, for changes that keep a frozen dataclass valid: its checks are not run again."""
    copy, own = object.__new__(type(value)), vars(value)
    fields: dict[str, Any] = type(value).__dataclass_fields__  # pyright: ignore[reportAttributeAccessIssue]
    vars(copy).update({name: own[name] for name in fields}, **changes)
    return copy
