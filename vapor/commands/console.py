"""What the commands share: reading options, progress bars, and how results are shown."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, NoReturn, TypeVar

import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from filtering.errors import VaporTrackError

Options = TypeVar("Options")


def _output(words: list[str]) -> Path:
    if not words[0].strip():
        raise ValueError("is empty, expected a path")
    return Path(words[0])


OutputPath = Annotated[
    Path,
    tyro.constructors.PrimitiveConstructorSpec(
        nargs=1,
        metavar="PATH",
        instance_from_str=_output,
        is_instance=lambda value: isinstance(value, Path),
        str_from_instance=lambda path: [str(path)],
    ),
]
"""A path to write to, which is not empty."""

Overwrite = Annotated[
    bool,
    tyro.conf.FlagCreatePairsOff,
    tyro.conf.arg(help="Write there even if something else is there, and replace what has the names of the results."),
]
"""Whether to replace what is not known to be results of an earlier call."""
_MIN_WIDTH = 100  # of a table, where the output is no terminal


def parse(command: str, options: type[Options], arguments: Sequence[str], default: Options | None = None) -> Options:
    """Options from the words of the command line; wrong ones print what is wrong and exit with status 2."""
    prog = f"vapor-track {command}"
    try:
        if default is None:
            return tyro.cli(options, prog=prog, args=list(arguments))
        return tyro.cli(options, prog=prog, args=list(arguments), default=default)
    except VaporTrackError as error:  # a value that its dataclass refuses
        usage_error(command, str(error))


def usage_error(command: str, message: str) -> NoReturn:
    """Exit with status 2 and one line."""
    print(f"vapor-track {command}: {message}", file=sys.stderr)
    sys.exit(2)


@contextmanager
def bar(verb: str) -> Iterator[Callable[[int, int], None]]:
    """A progress bar on standard error; yields a function of the number done and of all."""
    with progress_display() as display:
        task = display.add_task(verb, total=None)
        yield lambda done, total: display.update(task, completed=done, total=max(done, total))


@contextmanager
def progress_of(name: str) -> Iterator[Callable[[str, int, int | None], None]]:
    """A bar of work in several stages; yields a function of the stage, the number done and of all where it is known.

    A log gets a line a stage.
    """
    with progress_display() as display:
        task, before = display.add_task(name, total=None), ""

        def advance(stage: str, done: int, total: int | None) -> None:
            nonlocal before
            if stage != before and display.disable:
                print(f"{name}: {stage}", file=sys.stderr, flush=True)
            before = stage
            display.update(task, description=f"{name}: {stage}", completed=done, total=total)

        yield advance


@contextmanager
def progress_display(*columns: str) -> Iterator[Progress]:
    """A display of bars, counts and times; further `columns` are formats of a task's fields.

    Shown on terminals only, and gone after an error: what standard error then says is one line.
    """
    console = Console(stderr=True)
    display = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        *(TextColumn(column) for column in columns),
        console=console,
        disable=not console.is_terminal,
    )
    with display:
        try:
            yield display
        except BaseException:
            display.live.transient = True
            raise


def show(content: Any) -> None:
    """Print text or a table on standard output."""
    console = Console(highlight=False, soft_wrap=isinstance(content, str), markup=False)
    if not console.is_terminal:
        console.width = max(console.width, _MIN_WIDTH)
    console.print(content)


def show_notices(notices: Sequence[str]) -> None:
    """Say what a person should know of the data, a line each."""
    for notice in notices:
        show(f"  {notice}")


def show_skipped(skipped: Mapping[str, int]) -> None:
    """Say what was left out, if anything was."""
    for reason, count in skipped.items():
        show(f"  skipped {count}: {reason}")


def show_files(directory: Path, pictures: Sequence[str], *, recording: bool) -> None:
    """Say where the results of a run lie."""
    show(f"report     {directory / 'report.json'}")
    show(f"pictures   {', '.join(str(directory / name) for name in pictures)}")
    if recording:
        show(f"recording  rerun {directory / 'recording.rrd'}")
