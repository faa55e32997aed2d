"""`vapor-track completion`."""

from __future__ import annotations

import io
from collections.abc import Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass
from functools import reduce
from importlib import import_module
from operator import or_
from pkgutil import iter_modules
from typing import Annotated, Any, Literal

import tyro

import vapor.commands
from vapor.commands.console import parse
from vapor.commands.terminal import write

_FILES = {"bash": ("""eval "$(complete -p vapor-track | sed 's/^complete /complete -o default /')"  # or files""",)}
"""Lines added to tyro's script of a shell."""


@dataclass(frozen=True)
class Options:
    """Print the script by which a shell completes commands and their options."""

    shell: tyro.conf.Positional[Literal["bash", "zsh", "tcsh"]]
    """The shell."""


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    write(completion_script(parse("completion", Options, arguments).shell))


def completion_script(shell: str) -> str:
    """The script for a shell, made from the options of all commands."""
    modules = {
        each.name: import_module(f"vapor.commands.{each.name}") for each in iter_modules(vapor.commands.__path__)
    }
    commands: Any = reduce(
        or_,
        [
            Annotated[module.Options, tyro.conf.subcommand(name)]
            for name, module in modules.items()
            if hasattr(module, "main")
        ],
    )
    script = io.StringIO()
    try:
        with redirect_stdout(script):
            tyro.cli(commands, prog="vapor-track", args=["--tyro-print-completion", shell])
    except SystemExit:
        return "\n".join([*map(_on_one_line, script.getvalue().rstrip().splitlines()), *_FILES.get(shell, ())]) + "\n"
    raise AssertionError("tyro printed no completion")


def _on_one_line(line: str) -> str:
    """A line of the script. One holds all descriptions: a line break in them would be taken for another option."""
    return line.replace(r"\n", " ") if line.startswith("COMPLETION_SPEC") else line
