"""`vapor-track calibrate`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.table import Table

from vapor.calibrate import CalibrationResult, calibrate_model
from vapor.commands.console import bar, parse, show, show_skipped, usage_error
from vapor.observation import Device


@dataclass(frozen=True)
class Options:
    """Calibrate a trained model on held-out sequences with true poses; its weights stay as they are."""

    model: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="MODEL")]
    """Model file, or name of a model that ships."""
    data: Annotated[tyro.conf.Positional[tuple[str, ...]], tyro.conf.arg(metavar="DATA ...")]
    """MCAP files or data set folders that it was not trained on; PATH@START:STOP takes only those images."""
    output: Path
    """Model file to write (.safetensors)."""
    images: int = 500
    """Held-out images that are used, at most; as many again on stretches of trajectory."""
    seed: int = 0
    """Of latent noise and filter."""
    device: Device = "auto"
    """Where the network runs."""


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    o = parse("calibrate", Options, arguments)
    if not o.data:
        usage_error("calibrate", "no held-out data, expected at least one file or folder")
    if o.images < 1 or o.seed < 0:
        usage_error("calibrate", f"images {o.images} and seed {o.seed}, expected at least 1 and 0")
    with bar("filter runs") as advance:
        result = calibrate_model(
            o.model, o.data, o.output, max_images=o.images, seed=o.seed, device=o.device, advance=advance
        )
    show_calibration(result)
    show(str(o.output))
    show_skipped(result.skipped)


def show_calibration(result: CalibrationResult) -> None:
    """Print what each fit changed, and what it gains."""
    if result.changes:
        images = f"{result.images} held-out images, {result.stretches} stretches (odometry: {result.odometry})"
        table = Table(title=f"calibration on {images}", title_justify="left")
        for name in ("fit", "before", "after", "gain, nats an image", "likeliest"):
            table.add_column(name)
        for change in result.changes:
            gain = f"{change.gain:+.3f}" + ("" if change.error is None else f" ± {change.error:.3f}")
            highest = "" if change.preferred is None else f"{change.preferred:.3g}"
            table.add_row(change.what, _numbers(change.before), _numbers(change.after), gain, highest)
        show(table)
    for note in result.notes:
        show(f"calibration: {note}")


def _numbers(values: dict[str, float]) -> str:
    units = {"translation_m": " m", "rotation_rad": " rad"}
    unit = {name: next((u for end, u in units.items() if name.endswith(end)), "") for name in values}
    return ", ".join(f"{value:.3g}{unit[name]}" for name, value in values.items())
