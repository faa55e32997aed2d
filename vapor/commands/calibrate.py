"""`vapor-track calibrate`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import chain
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.table import Table

from filtering.measurement_noise import Six
from sequences.options import SequenceOptions
from sequences.outputs import refuse_other
from vapor.allocation import keep_freed_memory
from vapor.checkpoints.file_format import find_model, is_model, require_model_name
from vapor.commands.console import OutputPath, Overwrite, parse, show, show_notices, show_skipped, usage_error
from vapor.commands.model_name import ModelName
from vapor.commands.progress import progress
from vapor.engines.engine import Device
from vapor.evaluation.reliability import Reliability
from vapor.training_data.entries import files_read

if TYPE_CHECKING:  # torch is not needed for help and wrong options
    from vapor.calibration.calibrate import CalibrationResult

_BAR, _MARK, _WIDTH = "=", "|", 36  # of the diagram, characters


@dataclass(frozen=True)
class Options:
    """Calibrate a trained model on held-out sequences with true poses; its weights stay as they are."""

    model: tyro.conf.Positional[ModelName]
    """Name of a model that ships with the package, or model file."""
    data: Annotated[tyro.conf.Positional[tuple[str, ...]], tyro.conf.arg(metavar="DATA ...")]
    """MCAP files or data set folders that it was not trained on. PATH@100:200 takes only images 100 to 199."""
    output: OutputPath
    """Model file to write (.safetensors), new or an earlier model."""
    overwrite: Overwrite = False
    training: Annotated[tuple[str, ...], tyro.conf.arg(metavar="DATA ...")] = ()
    """Data that it was trained on, or some of them, to learn again what the place looks like. Needed after
    `train --no-calibrate`; without them half of the held-out data is used."""
    ood_only: bool = False
    """Learn only what the place looks like (the OOD score), and leave the rest as it is."""
    same_conditions: bool = False
    """State that the held-out data have the light and the season of use. Otherwise mistakes about the place are taken
    to last three times as long as in these data, as they do at another hour."""
    images: int = 500
    """Held-out images that are used, at most."""
    seed: int = 0
    """Seed of latent noise."""
    device: Device = "auto"
    """Where the network runs."""
    reading: Annotated[SequenceOptions, tyro.conf.arg(name="")] = field(default_factory=SequenceOptions)


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    o = parse("calibrate", Options, arguments)
    if o.images < 1 or o.seed < 0:
        usage_error("calibrate", f"images {o.images} and seed {o.seed}, expected at least 1 and 0")
    reads = chain([find_model(o.model)], files_read([*o.data, *o.training], o.reading))
    refuse_other(o.output, "model of vapor-track", is_model, reads=reads, overwrite=o.overwrite)
    require_model_name(o.output)
    from vapor.calibration.calibrate_model import calibrate_model

    keep_freed_memory()
    with progress("calibrating") as advance:
        result = calibrate_model(
            o.model,
            o.data,
            o.output,
            training=o.training,
            ood_only=o.ood_only,
            same_conditions=o.same_conditions,
            max_images=o.images,
            seed=o.seed,
            device=o.device,
            reading=o.reading,
            advance=advance,
        )
    show_calibration(result)
    show(str(o.output))
    show_skipped(result.skipped)
    show_notices(result.notices)


def show_calibration(result: CalibrationResult) -> None:
    """Print changes and gain of each fit, how often the best place is right, and what else was found."""
    if result.changes:
        table = Table(title=f"calibration on {_images(result)}", title_justify="left")
        table.add_column("setting", no_wrap=True)
        for name in ("before", "after", "gain in log likelihood, nats an image"):
            table.add_column(name)
        for change in result.changes:
            gain = "" if change.gain is None else f"{change.gain:+.3f}"
            for name in change.after:
                table.add_row(name, _text(name, change.before[name]), _text(name, change.after[name]), gain)
                gain = ""
            table.add_section()
        show(table)
    if result.reliability is not None:
        show(_reliability_table(result.reliability))
        show(
            "trust in the weights of places (1: their ratio is that of the places' probabilities, 0: none):"
            f" {result.weight_power:.2f} in a single image, {result.calibration.errors.weight_power:.2f} along a walk"
        )
    if result.calibration.errors.verified is not None:
        show(
            "the model's landmarks are as they were, with the errors that its training found: this calibrates images in"
            " which they verify no place"
        )
    show_errors(result)


def show_errors(result: CalibrationResult) -> None:
    """Print how many of the true poses are in the regions of single images, the noise of odometry, and notes."""
    from vapor.calibration.places import REGIONS

    if result.coverage is not None:
        found = ", ".join(f"{100 * fraction:.0f} %" for fraction in result.coverage)
        levels = ", ".join(f"{100 * level:.0f}" for level in REGIONS)
        show(f"true poses in the {levels} % regions of single images: {found}, on {_images(result)}")
    if result.calibration.odometry is not None and result.odometry != "none":
        show(f"{result.odometry}: {result.calibration.odometry}")
    for note in result.notes:
        show(f"calibration: {note}")


def _images(result: CalibrationResult) -> str:
    return f"{result.images} held-out images, worth {result.effective_images:.0f} independent ones"


def _reliability_table(found: Reliability) -> Table:
    """A reliability diagram of single images: bars of how often the best place is right, and its stated probability."""
    table = Table(title="the best place of a single image, by the network alone", title_justify="left")
    for name in ("stated", "right", "images", "independent", f"0 to 100 %: {_BAR} right, {_MARK} stated"):
        table.add_column(name, no_wrap=True)
    for each in found.bins:
        bar = [*(_BAR * round(_WIDTH * each.right)).ljust(_WIDTH)]
        bar[min(int(_WIDTH * each.stated), _WIDTH - 1)] = _MARK
        numbers = f"{each.stated:.0%}", f"{each.right:.0%}", str(each.images), f"{each.effective_images:.0f}"
        table.add_row(*numbers, "".join(bar))
    table.caption = f"expected calibration error {100 * found.expected_error:.1f} %, on the images of the fit"
    return table


def _text(name: str, value: float | Six) -> str:
    if isinstance(value, tuple):
        metres, radians = (" ".join(f"{number:.2g}" for number in part) for part in (value[:3], value[3:]))
        return f"{metres} m\n{radians} rad"
    return f"{value:.3g}" + (" m" if name.endswith("_m") else " rad" if name.endswith("_rad") else "")
