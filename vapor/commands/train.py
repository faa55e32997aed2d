"""`vapor-track train`."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field, make_dataclass
from functools import partial
from itertools import chain, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar, get_type_hints

import tyro
from rich.table import Table

from sequences.options import SequenceOptions
from sequences.outputs import refuse_other
from vapor.allocation import keep_freed_memory
from vapor.checkpoints.file_format import is_model, require_model_name
from vapor.commands.console import OutputPath, Overwrite, parse, show, show_notices, show_skipped, usage_error
from vapor.commands.progress import Progress, duration, progress
from vapor.training.config import TrainConfig
from vapor.training.presets import METHODS, PRESETS
from vapor.training_data.entries import files_read

if TYPE_CHECKING:  # torch is not needed for help and wrong options
    from vapor.evaluation.validation import Validation
    from vapor.training.progress import Progress as Where
    from vapor.training.progress import TrainingCheck, TrainResult

Preset = Annotated[str, tyro.conf.arg(metavar=f"{{{','.join(PRESETS)}}}")]
Method = Annotated[str | None, tyro.conf.arg(metavar=f"{{{','.join(METHODS)}}}")]

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
    """As `parse`, for options with a `config` whose default depends on their fields `names`, of `preset` and `method`.

    An unknown preset or method exits with status 2; `config` makes the default from their values, given by keyword.
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
    """The last value given for an option."""
    for word, following in pairwise([*arguments, ""]):
        if word == f"--{name}":
            default = following
        elif word.startswith(f"--{name}="):
            default = word.removeprefix(f"--{name}=")
    return default


@dataclass(frozen=True)
class Options:
    """Train a pose regressor on sequences or data sets with true poses."""

    data: Annotated[tyro.conf.Positional[tuple[str, ...]], tyro.conf.arg(metavar="DATA ...")]
    """MCAP files, data set folders or files that list a split. PATH@100:200 takes only images 100 to 199 of it."""
    output: OutputPath
    """Model file to write (.safetensors), new or an earlier model."""
    overwrite: Overwrite = False
    validation: Annotated[tuple[str, ...], tyro.conf.arg(metavar="DATA ...")] = ()
    """Held-out data, of other images. Default: passes over ground that other passes cover."""
    preset: Preset = "auto"
    """Named settings; other options change single ones of them. auto: suits the data, and takes a minute for some
    hundred images and mostly a quarter of an hour at most. demo: the network of the models that ship. tables: small and
    fast, for the scenes of that name. paper-...: the paper's."""
    method: Method = None
    """The regressor and its loss. Default: the preset's: retrieval for auto, variational for all others."""
    config: Annotated[TrainConfig, tyro.conf.arg(name="")] = PRESETS["auto"]
    reading: Annotated[SequenceOptions, tyro.conf.arg(name="")] = field(default_factory=SequenceOptions)


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    options = parse_named(
        "train",
        Options,
        arguments,
        ("preset", "method"),
        lambda preset, method: METHODS[method](PRESETS[preset]) if method else PRESETS[preset],
    )
    from vapor.training.processes import joined_processes

    keep_freed_memory()
    with joined_processes(options.config.device):
        _train(options)


def _train(options: Options) -> None:
    from vapor.commands.calibrate import show_errors
    from vapor.training.processes import is_first
    from vapor.training.state import is_training_state, state_path
    from vapor.training.train import train

    state = state_path(options.output)
    for path, kind, is_kind in (
        (options.output, "model of vapor-track", is_model),
        (state, "interrupted training", is_training_state),
    ):
        data = files_read([*options.data, *options.validation], options.reading)
        refuse_other(path, kind, is_kind, reads=chain(options.config.files_read, data), overwrite=options.overwrite)
    require_model_name(options.output)
    with progress() if is_first() else nullcontext() as shown:
        result = train(
            options.data,
            options.output,
            options.config,
            validation=options.validation,
            reading=options.reading,
            progress=None if shown is None else partial(_show_progress, shown),
        )
    if not is_first():
        return
    if result.calibration is not None:
        show_errors(result.calibration)
    if result.check is not None:
        show(_checked(result.check))
        show(result.check.verdict)
    show(_summary(result, options.output))
    show_skipped(result.skipped)
    show_notices(result.notices)


def _show_progress(shown: Progress, now: Where) -> None:
    figures = ""
    if now.loss is not None:
        figures = f"epoch {now.epoch}/{now.epochs}, loss {now.loss:.3f}"
    if now.validation is not None:
        held_out = f"{_recalls(now.validation)}, log density {now.validation.log_density:.2f}"
        figures += f", held out at epoch {now.validation.epoch}: {held_out}"
    unit = "images" if now.loss is None else "steps"
    shown.at(now.stage, now.done, now.total, unit=unit, figures=figures, left_s=now.left_s)
    for note in now.notes:
        shown.note(note)
    if now.left_s is not None and not now.epoch:
        shown.note(
            f"{now.epochs} epoch{'s' * (now.epochs != 1)} will take about {duration(now.left_s)}, by the time of"
            " some steps; then come landmarks and calibration"
        )


def _summary(result: TrainResult, output: Path) -> str:
    size_mb = output.stat().st_size / 1e6
    lines = [f"{output}: {size_mb:.1f} MB, {result.images_seen} images seen in {duration(result.seconds)}"]
    if result.best is not None:
        lines.append(
            f"kept epoch {result.best.epoch}; of {result.evaluated} held-out images {_recalls(result.best)} are within"
            f" 0.3 m and 20°; {result.evidence}"
        )
    return "\n".join(lines)


def _checked(check: TrainingCheck) -> Table:
    passes = "a held-out pass" if check.passes == 1 else f"{check.passes} held-out passes"
    table = Table(title=f"{check.images} images of {passes}, on which errors were fitted", title_justify="left")
    for name in ("method", "median error", "within 0.3 m, 20°"):
        table.add_column(name, justify="left" if name == "method" else "right")
    for name, figures in check.methods.items():
        error = f"{figures.median_m:.3f} m {figures.median_deg:.1f}°"
        table.add_row(name.replace("_", " "), error, f"{100 * figures.right:.0f} %")
    caption = f"the filter reports converged in {100 * check.converged:.0f} % of the images"
    if check.wrong is not None:
        caption += f", of which {100 * check.wrong:.1f} % are wrong"
    if check.coverage is not None:
        caption += "; of these in its regions: " + ", ".join(
            f"{name}: {100 * fraction:.0f} %" for name, fraction in check.coverage.items()
        )
    table.caption, table.caption_justify = caption, "left"
    return table


def _recalls(figures: Validation) -> str:
    return f"{100 * figures.sample_recall:.0f} % of samples, {100 * figures.mode_recall:.0f} % of best modes"
