"""`vapor-benchmark live`."""

from __future__ import annotations

import re
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.table import Table

from filtering.errors import VaporTrackError, require_within
from sequences.live.transport import MAX_DOMAIN
from sequences.outputs import claim_folder
from vapor.benchmark import PROGRAM
from vapor.benchmark.commands.cells import new_table
from vapor.benchmark.live.measure import Latency, Measured, measure
from vapor.benchmark.live.traffic import read_walk
from vapor.commands.console import InputPath, OutputPath, Overwrite, parse, show
from vapor.commands.progress import progress
from vapor.reporting.report import write_report
from vapor.storage import fetched

_LONGEST_MINUTES = 7 * 24 * 60


def _size(words: list[str]) -> tuple[int, int]:
    if not (match := re.fullmatch(r"(\d{1,5})x(\d{1,5})", words[0])):
        raise ValueError(f"is {words[0]!r}, expected width and height, such as 640x480")
    return int(match[1]), int(match[2])


Size = Annotated[
    tuple[int, int],
    tyro.constructors.PrimitiveConstructorSpec(
        nargs=1,
        metavar="WIDTHxHEIGHT",
        instance_from_str=_size,
        is_instance=lambda value: isinstance(value, tuple),
        str_from_instance=lambda size: ["x".join(map(str, size))],
    ),
]


@dataclass(frozen=True)
class Options:
    """Measure `live`: time from images and odometry to poses, memory, processor time."""

    model: str
    """Model file, or name of a model that ships: staircase, ceiling."""
    sequence: InputPath
    """Recording of the place of the model, with odometry; its first 300 images are played forwards, backwards, and so
    on."""
    rates: tuple[float, ...] = (10.0, 30.0)
    """Images a second, each for itself; at more than the recording has it is played as much faster."""
    sizes: tuple[Size, ...] = ((320, 240), (1280, 720))
    """Sizes that the images are brought to, each for itself."""
    minutes: float = 2.0
    """How long each is measured, from the first answer on."""
    domain: int = 60
    """ROS domain to do it in; nobody else may be in it."""
    live: str = ""
    """Further options of `live`, in one word: --live="--engine torch --reliable"."""
    output: OutputPath | None = None
    """Directory for live.json."""
    overwrite: Overwrite = False

    def __post_init__(self) -> None:
        require_within(self, minutes=(0.01, _LONGEST_MINUTES), domain=(0, MAX_DOMAIN))
        if not self.rates or not all(0.1 <= rate <= 1000.0 for rate in self.rates):
            raise VaporTrackError(f"rates are {self.rates}, expected numbers from 0.1 to 1000")
        if not self.sizes or not all(16 <= side <= 10_000 for size in self.sizes for side in size):
            raise VaporTrackError(f"sizes are {self.sizes}, expected sides of 16 to 10000 pixels")
        try:
            shlex.split(self.live)
        except ValueError as error:
            raise VaporTrackError(f"live is {self.live!r}, expected options: {error}") from error


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    o = parse("live", Options, arguments, program=PROGRAM)
    recording = fetched(o.sequence)
    if o.output is not None:
        claim_folder(o.output, f"{PROGRAM} live", reads=[recording], overwrite=o.overwrite)
    walk = read_walk(recording)
    words = ["--model", o.model, *shlex.split(o.live)]
    measured: list[Measured] = []
    for size in o.sizes:
        for rate in o.rates:
            with progress(f"{rate:g} Hz, {size[0]}x{size[1]}", "seconds") as advance:
                measured.append(
                    measure(
                        walk,
                        words,
                        domain=o.domain,
                        rate=rate,
                        size=size,
                        duration_s=60.0 * o.minutes,
                        advance=advance,
                    )
                )
            if o.output is not None:
                _write(o, o.output, measured)
    show(_table(o, measured))


def _write(o: Options, output: Path, measured: Sequence[Measured]) -> None:
    settings = {
        "model": o.model,
        "sequence": str(o.sequence),
        "minutes": o.minutes,
        "live": o.live,
    }
    write_report(output / "live.json", {"settings": settings, "measured": [each.stored for each in measured]})


def _table(o: Options, measured: Sequence[Measured]) -> Table:
    table = new_table(
        f"{o.model}, {o.minutes:g} min each: latencies are median, 99 % and longest, ms",
        "camera",
        *("played", "images\nsent", "answered", "image to pose", "odometry to\nbase pose", "memory, MB\nfirst, last"),
        *("processor", "published\nlate, 99 %"),
    )
    for each in measured:
        pose, usage = each.pose, each.usage
        table.add_row(
            f"{each.width}x{each.height}, {each.rate:g} Hz",
            f"{each.speed:.2g}×",
            str(pose.sent),
            f"{100 * pose.answered / max(pose.sent, 1):.1f} %",
            _cell(pose),
            _cell(each.base_pose),
            f"{usage.first_mb:.1f}  {usage.last_mb:.1f}",
            f"{100 * usage.processor:.0f} %",
            f"{each.late_p99_ms:.1f} ms",
        )
    return table


def _cell(latency: Latency) -> str:
    if not latency.answered:
        return "none"
    return f"{latency.median_ms:.1f}  {latency.p99_ms:.1f}  {latency.max_ms:.0f}"
