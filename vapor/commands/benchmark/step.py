"""`vapor-track benchmark step`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import tyro
from rich.table import Table

from filtering.errors import VaporTrackError, require_within
from vapor.benchmark.timing import time_step, untrained
from vapor.commands.console import parse, show
from vapor.observation import VaporObservationModel
from vapor.threads import limited_threads
from vapor.training.presets import PRESETS

_MAX_SEED = 2**63


@dataclass(frozen=True)
class Options:
    """Time the parts of a step: decoding, network, filter."""

    model: str = "staircase"
    """Model file, or name of a model that ships with the package."""
    preset: Annotated[str | None, tyro.conf.arg(metavar=f"{{{','.join(PRESETS)}}}")] = None
    """Time the network of this preset of `train` instead, with random weights and without the filter."""
    num_samples: int = 1000
    """Posterior samples per image."""
    hypotheses: tuple[int, ...] = (1000,)
    """Sizes of beliefs that the filter is timed with beside the usual one: so many hypotheses, none merged."""
    threads: int = 1
    """Processor threads of the network."""
    repetitions: int = 50
    """How often every part is timed."""
    seed: int = 0
    """Seed of all random draws."""

    def __post_init__(self) -> None:
        require_within(
            self, **dict.fromkeys(("num_samples", "threads", "repetitions"), (1, 10**6)), seed=(0, _MAX_SEED)
        )
        if self.preset is not None and self.preset not in PRESETS:
            raise VaporTrackError(f"unknown preset {self.preset!r}, expected one of {', '.join(PRESETS)}")
        if not self.hypotheses or min(self.hypotheses) < 1:
            raise VaporTrackError(f"hypotheses are {self.hypotheses}, expected numbers of at least 1")


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    o = parse("benchmark step", Options, arguments)
    network = o.model if o.preset is None else untrained(PRESETS[o.preset].network)
    model = VaporObservationModel.from_checkpoint(network, num_samples=o.num_samples)
    hypotheses = o.hypotheses if o.preset is None else ()
    table = Table("part of a step", "median ms", "95 % ms")
    with limited_threads(o.threads):
        timings = time_step(model, repetitions=o.repetitions, hypotheses=hypotheses, seed=o.seed)
    for timing in timings:
        table.add_row(timing.part, f"{timing.median_ms:.2f}", f"{timing.p95_ms:.2f}")
    show(table)
