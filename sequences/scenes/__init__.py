"""The synthetic scenes by name. Each is one module of this folder or, for `building`, a folder."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache
from importlib import import_module
from types import MappingProxyType
from typing import TYPE_CHECKING

from sequences.errors import SequenceError

if TYPE_CHECKING:
    from sequences.scenes.scene import Scene

# To add one: a module with a `Scene`, see `sequences.scenes.scene`, and its row here. The next free seed number is 5.
SCENES: Mapping[str, str] = MappingProxyType(
    {
        "staircase": "staircase.SCENE",
        "ceiling": "ceiling.SCENE",
        "round-table": "tables.ROUND_TABLE",
        "dinner-table": "tables.DINNER_TABLE",
        "corridor": "corridor.SCENE",
    }
)
"""Name -> module of this folder and name of its `Scene` there, imported when the scene is asked for."""

_BUILDING = re.compile(r"building-(0|[1-9][0-9]{0,5})")  # the number draws the scene; all buildings have cues


def is_scene(name: str) -> bool:
    """Whether there is a scene of this name."""
    return name in SCENES or _BUILDING.fullmatch(name) is not None


def scene_names(*, with_cues: bool = False) -> tuple[str, ...]:
    """Names to choose from, in the order of help texts; `building-N` stands for all numbers.

    Args:
        with_cues: Leave out scenes in which nothing is unique.
    """
    return *(name for name in SCENES if not with_cues or find_scene(name).has_cues), "building-N"


@cache
def find_scene(name: str) -> Scene:
    """A scene by name: one of `SCENES`, or a building, such as `building-7`.

    Raises:
        SequenceError: there is none of this name.
    """
    if name in SCENES:
        module, _, attribute = SCENES[name].partition(".")
        return getattr(import_module(f"{__name__}.{module}"), attribute)
    if matched := _BUILDING.fullmatch(name):
        return import_module(f"{__name__}.building.scene").draw_scene(int(matched[1]))
    raise SequenceError(
        f"unknown scene {name!r}, expected one of {', '.join(SCENES)}, "
        "or building-N with a number N below 1000000, such as building-7"
    )
