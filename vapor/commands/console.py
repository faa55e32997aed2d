"""What the commands share: reading options, and how results are shown."""

from __future__ import annotations

import io
import os
import shlex
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Annotated, Any, NoReturn, TypeVar

import tyro
from rich.console import Console
from rich.table import Table
from rich.text import Text

from filtering.errors import VaporTrackError, shortened
from vapor.commands.terminal import color_system, raise_of_output, say, width, wrapped, write
from vapor.storage import is_url, local_path

Options = TypeVar("Options")

_WIDE = 10_000  # characters


def _path_or_url(words: list[str]) -> Path:
    try:
        return local_path(words[0]) if is_url(words[0]) else Path(words[0])
    except VaporTrackError as error:
        raise ValueError(str(error)) from error


def _output(words: list[str]) -> Path:
    if is_url(words[0]):
        raise ValueError(f"is {words[0]}, expected a path, as only vapor-benchmark writes to URLs")
    return path_or_url_to_write(words)


def path_or_url_to_write(words: list[str]) -> Path:
    """The path that a word stands for, or of a URL that of its copy; ValueError for an empty one."""
    if not words[0].strip():
        raise ValueError("is empty, expected a path")
    return _path_or_url(words)


def path_given_by(instance_from_str: Callable[[list[str]], Path]) -> Any:
    """How an option reads its path."""
    return tyro.constructors.PrimitiveConstructorSpec(
        nargs=1,
        metavar="PATH",
        instance_from_str=instance_from_str,
        is_instance=lambda value: isinstance(value, Path),
        str_from_instance=lambda path: [str(path)],
    )


InputPath = Annotated[Path, path_given_by(_path_or_url)]
"""A path to read from, or a URL, of which it is the path of the copy (see `vapor.storage`)."""
OutputPath = Annotated[Path, path_given_by(_output)]
"""A path to write to, which is not empty."""

Overwrite = Annotated[
    bool,
    tyro.conf.FlagCreatePairsOff,
    tyro.conf.arg(help="Write there even if something else is there, and replace what has the names of the results."),
]
"""Whether to replace what is not known to be results of an earlier call."""


def command_line(command: str, arguments: Sequence[str], program: str = "vapor-track") -> str:
    """A command as one would type it, for the page that says what it found."""
    return shlex.join([program, command, *arguments])


def parse(
    command: str,
    options: type[Options],
    arguments: Sequence[str],
    default: Options | None = None,
    program: str = "vapor-track",
) -> Options:
    """Options from the words of the command line; wrong ones print what is wrong and exit with status 2."""
    given: dict[str, Any] = {} if default is None else {"default": default}
    told, helped, columns = io.StringIO(), _Help(), os.environ.get("COLUMNS")
    try:
        if not {"-h", "--help"} & set(arguments):
            os.environ["COLUMNS"] = "1000000"  # of messages in a box, so that no word is broken
        else:
            os.environ["COLUMNS"] = str(width())  # of the terminal, which is not seen behind `helped`
        with redirect_stderr(told), redirect_stdout(helped):
            return tyro.cli(options, prog=f"{program} {command}", args=arguments, **given)
    except VaporTrackError as error:  # a value that its dataclass refuses
        usage_error(command, str(error), program)
    except SystemExit:
        if told.getvalue():
            usage_error(command, _unboxed(told.getvalue()), program)
        show(Text.from_ansi(helped.getvalue()))
        raise
    finally:
        os.environ.pop("COLUMNS", None)
        if columns is not None:
            os.environ["COLUMNS"] = columns


class _Help(io.StringIO):
    """Standard output while help is made: its lines are wrapped before they are printed, and coloured as there."""

    def __init__(self) -> None:
        super().__init__()
        self._stdout = sys.stdout

    @property
    def encoding(self) -> str | None:  # pyright: ignore[reportIncompatibleVariableOverride]
        """With which boxes are drawn by their own characters, or by others."""
        return getattr(self._stdout, "encoding", None)

    def isatty(self) -> bool:
        return color_system() is not None and self._stdout is not None and self._stdout.isatty()


def _unboxed(text: str) -> str:
    """What is said in a box of tyro's, without help on options that are there."""
    parts: list[list[str]] = [[]]
    for line in text.splitlines()[1:-1]:
        line = line.strip(" │|")
        if line.strip("─-"):
            parts[-1].append(line)
        elif line:  # a rule between two parts
            parts.append([])
    sentences = [" ".join(" ".join(part).split()) for part in parts]
    return "; ".join(s for s in sentences if s and not s.startswith(("Argument helptext", "For full helptext")))


def usage_error(command: str, message: str, program: str = "vapor-track") -> NoReturn:
    """Exit with status 2 and one line."""
    say(f"{program} {command}: {message}")
    sys.exit(2)


def show(content: str | Text | Table) -> None:
    """Print text or a table on standard output; no line is longer than fits but where a table's words would be cut."""
    if isinstance(content, str):
        at_terminal = sys.stdout is not None and sys.stdout.isatty()
        write("\n".join(map(wrapped, content.splitlines())) if at_terminal else content)
        return
    console = Console(highlight=False, markup=False, width=width(), color_system=color_system())
    if isinstance(content, Table) and any("…" in segment.text for segment in console.render(content)):
        console.width = console.measure(content, options=console.options.update_width(_WIDE)).maximum
    try:
        console.print(content)
    except OSError as error:
        raise_of_output(error)


def show_notices(notices: Sequence[str]) -> None:
    """Say what a person should know of the data, a line each."""
    for notice in notices:
        _show_line(f"  {notice}")


def show_skipped(skipped: Mapping[str, int]) -> None:
    """Say what was left out, if anything was."""
    show_notices(skipped_lines(skipped))


def skipped_lines(skipped: Mapping[str, int]) -> list[str]:
    """What was left out, a line for each reason."""
    return [f"skipped {count}: {reason}" for reason, count in skipped.items()]


def _show_line(text: str) -> None:
    """One line of at most `MAX_MESSAGE` characters, as names of topics and frames in a file may be of any length."""
    show(shortened(" ".join(text.splitlines())))


def show_images(images: Mapping[str, Any]) -> None:
    """Say what became of the images that a sequence states."""
    show(f"images     {images_said(images)}")


def images_said(images: Mapping[str, Any]) -> str:
    """What became of the images that a sequence states."""
    skipped = sum(images["skipped"].values())
    return f"{images['stated']} stated, {images['read']} read, {images['used']} used, {skipped} skipped"


def show_files(directory: Path, *, recording: bool) -> None:
    """Say where the results of a run lie."""
    show(f"report     {directory / 'report.html'}")
    if recording:
        show(f"recording  rerun {directory / 'recording.rrd'}")
