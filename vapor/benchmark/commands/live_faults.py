"""`vapor-benchmark live-faults`."""

from __future__ import annotations

import json
import math
import shlex
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass

from filtering.errors import VaporTrackError, require_within
from sequences.live.transport import MAX_DOMAIN
from vapor.benchmark import PROGRAM
from vapor.benchmark.commands.cells import new_table
from vapor.benchmark.live.faults import FAULTS, Outcome, run_fault
from vapor.benchmark.live.traffic import read_walk
from vapor.commands.console import InputPath, parse, show
from vapor.commands.progress import progress
from vapor.commands.terminal import write
from vapor.storage import fetched


@dataclass(frozen=True)
class Options:
    """Let faults happen to a robot that `live` follows: published messages, time without convergence, recovery."""

    model: str
    """Model file, or name of a model that ships: staircase, ceiling."""
    sequence: InputPath
    """Recording of the place of the model, with odometry and true poses."""
    faults: tuple[str, ...] = tuple(FAULTS)
    """Which: none, killed, camera, odometry, slow, lossy, lossy-reliable, clock."""
    domain: int = 62
    """ROS domain to do it in; nobody else may be in it."""
    live: str = ""
    """Further options of `live`, in one word: --live="--engine torch"."""

    def __post_init__(self) -> None:
        require_within(self, domain=(0, MAX_DOMAIN))
        for name in self.faults:
            if name not in FAULTS:
                raise VaporTrackError(f"fault {name!r} is not known, expected some of {', '.join(FAULTS)}")


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    options = parse("live-faults", Options, arguments, program=PROGRAM)
    recording = fetched(options.sequence)
    walk = read_walk(recording)
    if walk.world_from_camera is None:
        raise VaporTrackError(f"{recording}: not all images have true poses, expected them to measure errors by")
    words = ["--model", options.model, *shlex.split(options.live)]
    table = new_table(
        f"{recording.name}: ten images a second, a fault once converged for 5 s",
        "fault",
        *("poses/s", "tf/s", "not sure\nafter", "sure again\nafter", "off > 1 m", "worst"),
    )
    outcomes: list[Outcome] = []
    with progress("faults", "faults") as advance:
        for number, name in enumerate(options.faults, start=1):
            outcome = run_fault(FAULTS[name], recording, walk, words, domain=options.domain, sleep=time.sleep)
            outcomes.append(outcome)
            table.add_row(*_cells(outcome))
            advance(number, len(options.faults))
    show(table)
    for outcome in outcomes:
        show(f"{outcome.label}: {', '.join(outcome.statuses)}")
        write(json.dumps(asdict(outcome)))


def _cells(o: Outcome) -> list[str]:
    return [
        o.label,
        f"{o.poses_per_s:.1f}",
        f"{o.transforms_per_s:.1f}",
        "never" if o.unsure_after_s is None else f"{o.unsure_after_s:.1f} s",
        "never" if o.recovered_after_s is None else f"{o.recovered_after_s:.1f} s",
        f"{o.wrong_s:.1f} s",
        "–" if math.isnan(o.worst_m) else f"{o.worst_m:.2f} m",
    ]
