"""`vapor-track convert`."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Annotated

import tyro

from filtering.errors import quoted
from sequences.datasets.convert import convert
from sequences.datasets.listing import files_read
from sequences.odometry import OdometryNoise
from sequences.outputs import refuse_other
from sequences.writer import is_own_sequence
from vapor.commands.console import OutputPath, Overwrite, parse, show, show_notices, show_skipped, usage_error
from vapor.commands.progress import progress


@dataclass(frozen=True)
class Options:
    """Write a data set of images with true poses as an MCAP sequence."""

    dataset: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DATASET")]
    """Folder of the data set, of any layout that `train` takes, or the file that lists a split of it."""
    output: Annotated[tyro.conf.Positional[OutputPath], tyro.conf.arg(metavar="OUT.mcap")]
    """MCAP file to write, new or converted before."""
    overwrite: Overwrite = False
    odometry: Path | None = None
    """Recorded odometry: a TUM trajectory of the camera in any frame. Only the relative motion counts."""
    odometry_noise: tyro.conf.FlagCreatePairsOff[bool] = False
    """Simulate odometry from the true poses, with the noise below."""
    noise: OdometryNoise = field(default_factory=OdometryNoise)
    frames: Annotated[str, tyro.conf.arg(metavar="START:STOP")] = ":"
    """Which images, such as 100:200 for images 100 to 199; : for all."""
    seed: int = 0
    """Seed of simulated odometry."""


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    o = parse("convert", Options, arguments)
    match = re.fullmatch(r"(\d{0,9}):(\d{0,9})", o.frames)
    if match is None:
        usage_error("convert", f"--frames is {quoted(o.frames)}, expected START:STOP with whole numbers")
    if o.odometry is not None and o.odometry_noise:
        usage_error("convert", "--odometry and --odometry-noise exclude each other")
    if o.noise != OdometryNoise() and not o.odometry_noise:
        usage_error("convert", "--noise.* are settings of simulated odometry, expected --odometry-noise with them")
    reads = chain([] if o.odometry is None else [o.odometry], files_read(o.dataset))
    refuse_other(o.output, "sequence that vapor-track wrote", is_own_sequence, reads=reads, overwrite=o.overwrite)
    start, stop = (int(number) if number else None for number in match.groups())
    with progress("converting") as advance:
        summary = convert(
            o.dataset,
            o.output,
            odometry=o.odometry,
            odometry_noise=o.noise if o.odometry_noise else None,
            frames=slice(start, stop),
            seed=o.seed,
            progress=advance,
        )
    show(f"{o.output}: {summary.num_images} images; odometry: {summary.odometry}")
    show_skipped(summary.skipped)
    show_notices(summary.notices)
