"""`vapor-benchmark live-faults`."""

from __future__ import annotations

import shlex
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from filtering.errors import VaporTrackError, require_within
from sequences.live.transport import MAX_DOMAIN
from vapor.benchmark import PROGRAM
from vapor.benchmark.commands.options import SummaryPath, claim_summary, require_each_once, write_rows
from vapor.benchmark.figures import table_of, text
from vapor.benchmark.live.faults import FAULTS, Outcome, run_fault
from vapor.benchmark.live.traffic import read_walk
from vapor.commands.console import parse, show
from vapor.commands.model_name import ModelName
from vapor.commands.progress import progress


@dataclass(frozen=True)
class Options:
    """Let faults happen to a robot that `live` follows: published messages, time without convergence, recovery."""

    model: ModelName
    """Name of a model that ships, or model file."""
    sequence: Path
    """Recording of the place of the model, with odometry and true poses."""
    faults: tuple[str, ...] = tuple(FAULTS)
    """Which: none, killed, camera, odometry, slow, lossy, lossy-reliable, clock."""
    summary: SummaryPath = None
    domain: int = 62
    """ROS domain to do it in; nobody else may be in it."""
    live: str = ""
    """Further options of `live`, in one word: --live="--engine torch"."""

    def __post_init__(self) -> None:
        require_within(self, domain=(0, MAX_DOMAIN))
        require_each_once("faults", self.faults, FAULTS)


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    o = parse("live-faults", Options, arguments, program=PROGRAM)
    claim_summary(o.summary)
    walk = read_walk(o.sequence)
    if walk.world_from_camera is None:
        raise VaporTrackError(f"{o.sequence}: not all images have true poses, expected them to measure errors by")
    words = ["--model", o.model, *shlex.split(o.live)]
    outcomes: dict[str, Outcome] = {}
    with progress("faults", "faults") as advance:
        for name in o.faults:
            fault = FAULTS[name]
            outcomes[fault.label] = run_fault(fault, o.sequence, walk, words, domain=o.domain, sleep=time.sleep)
            advance(len(outcomes), len(o.faults))
    title = f"{o.sequence.name}: ten images a second, a fault once converged for 5 s"
    show(table_of(title, "fault", _COLUMNS, outcomes))
    write_rows(o.summary, ({"fault": label} | asdict(outcome) for label, outcome in outcomes.items()))
    for label, outcome in outcomes.items():
        show(f"{label}: {', '.join(outcome.statuses)}")


def _after(seconds: float | None) -> str:
    return "never" if seconds is None else f"{seconds:.1f} s"


_COLUMNS: dict[str, Callable[[Outcome], str]] = {
    "poses/s": lambda outcome: f"{outcome.poses_per_s:.1f}",
    "tf/s": lambda outcome: f"{outcome.transforms_per_s:.1f}",
    "not sure\nafter": lambda outcome: _after(outcome.unsure_after_s),
    "sure again\nafter": lambda outcome: _after(outcome.recovered_after_s),
    "off > 1 m": lambda outcome: f"{outcome.wrong_s:.1f} s",
    "worst": lambda outcome: text(outcome.worst_m, ".2f", " m"),
}
