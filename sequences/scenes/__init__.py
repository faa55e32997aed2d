"""The synthetic scenes by name. Each is a module of this folder, or a folder, which says everything about it."""

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
        "staircase": "staircase.scene.SCENE",
        "ceiling": "ceiling.scene.SCENE",
        "round-table": "tables.ROUND_TABLE",
        "dinner-table": "tables.DINNER_TABLE",
        "corridor": "corridor.scene.SCENE",
    }
)
"""Name -> module of this folder and name of its `Scene` there, imported when the scene is asked for."""

NUMBERED_SCENES: Mapping[str, str] = MappingProxyType({"building": "building.scene"})
"""Kind -> module with a function `draw_scene`, where a number draws the scene: `building-7`. All have unique things."""

_MOST = 10**6  # numbers of a kind
_NUMBERED = re.compile(rf"({'|'.join(NUMBERED_SCENES)})-(0|[1-9][0-9]{{0,5}})")


def is_scene(name: str) -> bool:
    """Whether there is a scene of this name."""
    return name in SCENES or _NUMBERED.fullmatch(name) is not None


def scene_names(*, with_cues: bool = False) -> tuple[str, ...]:
    """Names to choose from, in the order of help texts; `building-N` stands for all numbers.

    Args:
        with_cues: Leave out scenes in which nothing is unique.
    """
    names = [name for name in SCENES if not with_cues or find_scene(name).has_cues]
    return *names, *(f"{kind}-N" for kind in NUMBERED_SCENES)


@cache
def find_scene(name: str) -> Scene:
    """A scene by name: one of `SCENES`, or one that a number draws, such as `building-7`.

    Raises:
        SequenceError: there is none of this name.
    """
    if name in SCENES:
        module, _, attribute = SCENES[name].rpartition(".")
        return getattr(import_module(f"{__name__}.{module}"), attribute)
    if matched := _NUMBERED.fullmatch(name):
        return import_module(f"{__name__}.{NUMBERED_SCENES[matched[1]]}").draw_scene(int(matched[2]))
    numbered = "".join(f", or {kind}-N with a number N below {_MOST}, such as {kind}-7" for kind in NUMBERED_SCENES)
    raise SequenceError(f"unknown scene {name!r}, expected one of {', '.join(SCENES)}{numbered}")
