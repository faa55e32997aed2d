"""`vapor-benchmark out-of-distribution`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Annotated

import numpy as np
import tyro
from rich.table import Table

from filtering.errors import VaporTrackError, require_within
from vapor.benchmark import PROGRAM
from vapor.benchmark.commands.options import SummaryPath, claim_summary, write_rows
from vapor.benchmark.ood_images import IN_A_ROW, evaluate_flags
from vapor.commands.console import parse, show
from vapor.commands.model_name import ModelName
from vapor.commands.progress import progress
from vapor.engines.engine import Device, EngineConfig
from vapor.observation import VaporObservationModel

_MAX_SEED = 2**63


@dataclass(frozen=True)
class Options:
    """Count images of a place that are flagged as out of distribution, and others that are not."""

    model: tyro.conf.Positional[ModelName]
    """Model file, or name of a model that ships."""
    known: Annotated[tuple[str, ...], tyro.conf.arg(metavar="DATA ...")]
    """MCAP files or data set folders of its place that it was not trained on; PATH@START:STOP takes a part."""
    other: Annotated[tuple[str, ...], tyro.conf.arg(metavar="DATA ...")] = ()
    """Likewise, of other places."""
    every: int = 1
    """Take only every so many images."""
    seed: int = 0
    """Seed of the noise."""
    device: Device = "auto"
    """Where the network runs."""
    summary: SummaryPath = None
    network: Annotated[EngineConfig, tyro.conf.arg(name="")] = field(default_factory=EngineConfig)

    def __post_init__(self) -> None:
        require_within(self, every=(1, 10**6), seed=(0, _MAX_SEED))
        if not self.known:
            raise VaporTrackError("no known data, expected at least one file or folder")


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    o = parse("out-of-distribution", Options, arguments, program=PROGRAM)
    claim_summary(o.summary)
    model = VaporObservationModel.from_checkpoint(
        o.model, num_samples=1, device=o.device, engine=o.network.engine, precision=o.network.precision
    )
    table = Table("images", "how many", "median score", "flagged", f"flagged, median of {IN_A_ROW}")
    with progress("evaluating", "recordings") as advance:
        rows = evaluate_flags(model, o.known, o.other, every=o.every, seed=o.seed, advance=advance)
    for row in rows:
        in_a_row = "" if np.isnan(row.fraction_in_a_row) else f"{100 * row.fraction_in_a_row:.1f} %"
        table.add_row(row.kind, str(row.images), f"{row.median:.2f}", f"{100 * row.fraction:.1f} %", in_a_row)
    show(table)
    write_rows(o.summary, map(asdict, rows))
