"""Options of the commands, and their output."""

from __future__ import annotations

import io
import os
import re
import shlex
import sys
from collections.abc import Mapping, Sequence
from contextlib import redirect_stderr
from copy import copy
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, NoReturn, TypeVar

import tyro
from rich.console import Console
from rich.table import Table
from rich.text import Text

from filtering.errors import VaporTrackError, shortened
from vapor.commands.command_help import Command
from vapor.commands.terminal import color_system, raise_of_output, width, wrapped, write, write_error
from vapor.commands.wrong_arguments import missing_arguments, what_is_wrong

Options = TypeVar("Options")

_WIDE = 10_000  # characters


def _path(words: list[str]) -> Path:
    if not words[0].strip():
        raise ValueError("is empty, expected a path")
    return Path(words[0])


OutputPath = Annotated[
    Path,
    tyro.constructors.PrimitiveConstructorSpec(
        nargs=1,
        metavar="PATH",
        instance_from_str=_path,
        is_instance=lambda value: isinstance(value, Path),
        str_from_instance=lambda path: [str(path)],
    ),
]
"""A path to write to, which is not empty."""

Overwrite = Annotated[
    bool,
    tyro.conf.FlagCreatePairsOff,
    tyro.conf.arg(help="Write even if something else is there, and replace what has the names of the results."),
]
"""Whether to replace files that are not known to be results of an earlier call."""


def command_line(command: str, arguments: Sequence[str], program: str = "vapor-track") -> str:
    """A command as one would type it, for its page."""
    return shlex.join([program, command, *arguments])


def _has_address(before: str, word: str) -> bool:
    """Whether a word is, or has after =, the value of an option that takes the address of a server."""
    return before in ("--view-at", "--dask") or word.startswith(("--view-at=", "--dask="))


def parse(command: str, options: type[Options], arguments: Sequence[str], program: str = "vapor-track") -> Options:
    """Options from the words of the command line; wrong ones print a line and exit with status 2."""
    for before, word in pairwise(["", *arguments]):
        if (url := re.search(r"(?:^|[=,])([a-z][a-z0-9+.-]*://\S*)", word)) and not _has_address(before, word):
            usage_error(command, f"{url[1]}: expected a path; copy or mount it first", program)
        if not word and not before.startswith("--"):
            usage_error(command, "an argument is '', expected a path or a name", program)
    if {"-h", "--help"} & set(arguments):
        show_help(Command.of(f"{program} {command}", options))
        sys.exit(0)
    errors, columns = io.StringIO(), os.environ.get("COLUMNS")
    try:
        os.environ["COLUMNS"] = "1000000"  # in messages no word is broken
        with redirect_stderr(errors):
            parsed = tyro.cli(options, prog=f"{program} {command}", args=arguments)
    except VaporTrackError as error:  # a value that its dataclass refuses
        usage_error(command, str(error), program)
    except SystemExit:
        if errors.getvalue():
            wrong = what_is_wrong(arguments, errors.getvalue(), Command.of(f"{program} {command}", options))
            usage_error(command, wrong, program)
        raise
    finally:
        os.environ.pop("COLUMNS", None)
        if columns is not None:
            os.environ["COLUMNS"] = columns
    if () in vars(parsed).values() and (
        missing := missing_arguments(arguments, Command.of(f"{program} {command}", options))
    ):
        usage_error(command, "; ".join(missing), program)
    return parsed


def show_help(command: Command) -> None:
    """Print what a command does and its options, in lines as wide as the terminal."""
    show(command.shown(width()))


def usage_error(command: str, message: str, program: str = "vapor-track") -> NoReturn:
    """Exit with status 2 and one line."""
    write_error(f"{program} {command}: {message}")
    sys.exit(2)


def show(content: str | Text | Table) -> None:
    """Print text or a table on standard output; no line is longer than fits but where a table's words would be cut.

    A table's title is a line of text above it: it may name a file, and Rich would fold it within a word.
    """
    if isinstance(content, str):
        at_terminal = sys.stdout is not None and sys.stdout.isatty()
        write("\n".join(map(wrapped, content.splitlines())) if at_terminal else content)
        return
    if isinstance(content, Table) and content.title is not None:
        write(wrapped(str(content.title)))
        content = copy(content)
        content.title = None
    console = Console(highlight=False, markup=False, width=width(), color_system=color_system())
    if isinstance(content, Table) and any("…" in segment.text for segment in console.render(content)):
        console.width = console.measure(content, options=console.options.update_width(_WIDE)).maximum
    try:
        console.print(content)
    except OSError as error:
        raise_of_output(error)


def show_notices(notices: Sequence[str]) -> None:
    """Print warnings and hints, a line of at most `MAX_MESSAGE` characters each: names in files have any length."""
    for notice in notices:
        show(shortened(" ".join(f"  {notice}".splitlines())))


def show_skipped(skipped: Mapping[str, int]) -> None:
    """Print counts of skipped images and messages, a line for each reason."""
    show_notices(skipped_lines(skipped))


def skipped_lines(skipped: Mapping[str, int]) -> list[str]:
    """Counts of skipped images and messages, a line for each reason."""
    return [f"skipped {count}: {reason}" for reason, count in skipped.items()]


def count_images(images: Mapping[str, Any]) -> str:
    """Counts of the images of a sequence, in words."""
    skipped = sum(images["skipped"].values())
    return f"{images['stated']} stated, {images['read']} read, {images['used']} used, {skipped} skipped"


def show_files(directory: Path, *, recording: bool) -> None:
    """Print the paths of the results of a run."""
    show(f"report     {directory / 'report.html'}")
    if recording:
        show(f"recording  rerun {directory / 'recording.rrd'}")
