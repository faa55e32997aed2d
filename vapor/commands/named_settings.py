"""Options that name a preset and a method, from which the defaults of the other options follow."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import make_dataclass
from typing import Annotated, Any, TypeVar, get_type_hints

import tyro

from vapor.commands.console import parse, usage_error
from vapor.training.presets import METHODS, PRESETS

Preset = Annotated[str, tyro.conf.arg(metavar=f"{{{','.join(PRESETS)}}}")]
Method = Annotated[str, tyro.conf.arg(metavar=f"{{{','.join(METHODS)}}}")]

_KNOWN: Mapping[str, Collection[str]] = {"preset": PRESETS, "method": METHODS}
_Options = TypeVar("_Options")


def parse_named(
    command: str,
    options: type[_Options],
    arguments: Sequence[str],
    names: Sequence[str],
    config: Callable[..., Any],
    program: str = "vapor-track",
) -> _Options:
    """Options as `parse` reads them, with defaults that are named among them; an unknown name exits with status 2.

    Args:
        command: Its name, for messages.
        options: A frozen dataclass with a `config` and the fields `names`.
        arguments: Words of the command line.
        names: Which of `preset` and `method` there are.
        config: Makes the default of `config` from what they name, given by keyword.
        program: That has the command.
    """
    chosen = {name: _named(arguments, name, getattr(options, name)) for name in names}
    for name, value in chosen.items():
        if value is not None and value not in _KNOWN[name]:
            usage_error(command, f"unknown {name} {value!r}, expected one of {', '.join(_KNOWN[name])}", program)
    hints = get_type_hints(options, include_extras=True)
    defaults = {**chosen, "config": config(**chosen)}
    fields = [(name, hints[name], value) for name, value in defaults.items()]
    named = make_dataclass("Options", fields, bases=(options,), frozen=True, namespace={"__doc__": options.__doc__})
    return parse(command, named, arguments, program=program)


def _named(arguments: Sequence[str], name: str, default: str | None) -> str | None:
    """The last value given for an option; it is read before all others, since their defaults depend on it."""
    for word, following in zip(arguments, [*arguments[1:], ""], strict=True):
        if word == f"--{name}":
            default = following
        elif word.startswith(f"--{name}="):
            default = word.removeprefix(f"--{name}=")
    return default
