"""Long series of cases: the suite tries a few of each, and all with `FULL=1`."""

import os
from typing import TypeVar

import pytest

FULL = bool(os.environ.get("FULL"))
Value = TypeVar("Value")


def some(first: int, values: list[Value]) -> list[Value]:
    """The first few of the values; with `FULL=1` all."""
    return values if FULL else values[:first]


full = pytest.mark.skipif(not FULL, reason="with FULL=1: a quicker test looks at the same")
