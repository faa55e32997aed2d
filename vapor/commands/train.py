"""`vapor-track train`."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, make_dataclass
from pathlib import Path
from typing import Annotated

import tyro

from vapor.commands.calibrate import show_calibration
from vapor.commands.console import parse, progress_display, show, usage_error
from vapor.presets import METHODS, PRESETS
from vapor.train import Progress, TrainConfig, TrainResult, train
from vapor.validation import Validation

_Preset = Annotated[str, tyro.conf.arg(metavar=f"{{{','.join(PRESETS)}}}")]
_Method = Annotated[str, tyro.conf.arg(metavar=f"{{{','.join(METHODS)}}}")]


@dataclass(frozen=True)
class Options:
    """Train a pose regressor on sequences or data sets with true poses."""

    data: Annotated[tyro.conf.Positional[tuple[str, ...]], tyro.conf.arg(metavar="DATA ...")]
    """MCAP files, data set folders or files that list a split; PATH@START:STOP takes only those images of it."""
    output: Path
    """Model file to write (.safetensors)."""
    validation: Annotated[tuple[str, ...], tyro.conf.arg(metavar="DATA ...")] = ()
    """Held-out data; without it the last part of each training sequence is held out."""
    preset: _Preset = "demo"
    """Named settings, of which the options below change single ones."""
    method: _Method = "variational"
    """What is trained: the variational regressor, one without its sampling or its KL divergence, or another one."""
    config: Annotated[TrainConfig, tyro.conf.arg(name="")] = PRESETS["demo"]


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    preset, method = (_named(arguments, option) for option in ("preset", "method"))
    for what, name, known in (("preset", preset, PRESETS), ("method", method, METHODS)):
        if name not in known:
            usage_error("train", f"unknown {what} {name!r}, expected one of {', '.join(known)}")
    options = parse("train", _options(preset, method), arguments)
    if not options.data:
        usage_error("train", "no training data, expected at least one file or folder")
    with _display() if sys.stderr.isatty() else _log() as report:
        result = train(options.data, options.output, options.config, validation=options.validation, progress=report)
    if result.calibration is not None:
        show_calibration(result.calibration)
    show(_summary(result, options.output))


def _options(preset: str, method: str) -> type[Options]:
    """The options with the defaults of a preset and a method."""
    flat = Annotated[TrainConfig, tyro.conf.arg(name="")]
    config = METHODS[method](PRESETS[preset])
    defaults = [("preset", _Preset, preset), ("method", _Method, method), ("config", flat, config)]
    return make_dataclass("Options", defaults, bases=(Options,), frozen=True, namespace={"__doc__": Options.__doc__})


def _named(arguments: Sequence[str], option: str) -> str:
    """Preset and method must be known before the options are read, since they are their defaults."""
    for word, following in zip(arguments, [*arguments[1:], ""], strict=True):
        if word == f"--{option}":
            return following
        if word.startswith(f"--{option}="):
            return word.removeprefix(f"--{option}=")
    return getattr(Options, option)


@contextmanager
def _log() -> Iterator[Callable[[Progress], None]]:
    """For a log file: a line an epoch."""
    last = 0

    def report(progress: Progress) -> None:
        nonlocal last
        figures = progress.validation
        if figures is not None and figures.epoch > last:
            last = figures.epoch
            line = f"epoch {last}/{progress.epochs}  loss {figures.train_loss:.3f}  held out: {_recalls(figures)}"
            print(f"{line}, log density {figures.log_density:.2f}", file=sys.stderr, flush=True)

    yield report


@contextmanager
def _display() -> Iterator[Callable[[Progress], None]]:
    with progress_display("{task.fields[figures]}") as display:
        task = display.add_task("reading images", total=None, figures="")
        stage = "reading"

        def report(progress: Progress) -> None:
            nonlocal stage
            if progress.stage != stage:
                stage = progress.stage
                display.reset(task, description=stage, total=progress.total)
            figures = ""
            if progress.loss is not None:
                figures = f"epoch {progress.epoch}/{progress.epochs}  loss {progress.loss:.3f}"
            if progress.validation is not None:
                figures += f"  held out: {_recalls(progress.validation)}"
            display.update(task, completed=progress.done, figures=figures)

        yield report


def _summary(result: TrainResult, output: Path) -> str:
    size_mb = output.stat().st_size / 1e6
    lines = [f"{output}: {size_mb:.1f} MB, {result.images_seen} images seen in {result.seconds / 60:.1f} minutes"]
    if result.best is not None:
        lines.append(f"kept epoch {result.best.epoch}; held out within 0.3 m and 20°: {_recalls(result.best)}")
    return "\n".join(lines)


def _recalls(figures: Validation) -> str:
    return f"{100 * figures.sample_recall:.0f} % of samples, {100 * figures.mode_recall:.0f} % of best modes"
