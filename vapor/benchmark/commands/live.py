"""`vapor-benchmark live`."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path
from typing import Annotated

import tyro

from filtering.errors import VaporTrackError, require_within
from sequences.live.transport import MAX_DOMAIN
from vapor.benchmark import PROGRAM
from vapor.benchmark.commands.options import SummaryPath, claim_summary, write_rows
from vapor.benchmark.figures import table_of
from vapor.benchmark.live.measure import Latency, Measured, measure
from vapor.benchmark.live.traffic import read_walk
from vapor.commands.console import parse, show
from vapor.commands.model_name import ModelName
from vapor.commands.progress import progress

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

    model: ModelName
    """Name of a model that ships, or model file."""
    sequence: Path
    """Recording of the place of the model, with odometry; its first 300 images are played forwards, backwards, and so
    on."""
    rates: tuple[float, ...] = (10.0, 30.0)
    """Images a second, each for itself; at more than the recording has it is played as much faster."""
    sizes: tuple[Size, ...] = ((320, 240), (1280, 720))
    """Sizes that the images are brought to, each for itself."""
    minutes: float = 2.0
    """How long each is measured, from the first answer on."""
    summary: SummaryPath = None
    domain: int = 60
    """ROS domain to do it in; nobody else may be in it."""
    live: str = ""
    """Further options of `live`, in one word: --live="--engine torch --reliable"."""

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
    claim_summary(o.summary)
    walk = read_walk(o.sequence)
    words = ["--model", o.model, *shlex.split(o.live)]
    rows: dict[str, Measured] = {}
    for (width, height), rate in product(o.sizes, o.rates):
        camera = f"{width}x{height}, {rate:g} Hz"
        with progress(camera, "seconds") as advance:
            rows[camera] = measure(
                walk,
                words,
                domain=o.domain,
                rate=rate,
                size=(width, height),
                duration_s=60.0 * o.minutes,
                advance=advance,
            )
    title = f"{o.model}, {o.minutes:g} min each: latencies are median, 99 % and longest, ms"
    show(table_of(title, "camera", _COLUMNS, rows))
    write_rows(o.summary, ({"camera": camera, "minutes": o.minutes} | asdict(row) for camera, row in rows.items()))


def _latency(latency: Latency) -> str:
    if not latency.answered:
        return "none"
    return f"{latency.median_ms:.1f}  {latency.p99_ms:.1f}  {latency.max_ms:.0f}"


_COLUMNS: dict[str, Callable[[Measured], str]] = {
    "played": lambda each: f"{each.speed:.2g}×",
    "images\nsent": lambda each: str(each.pose.sent),
    "answered": lambda each: f"{100 * each.pose.answered / max(each.pose.sent, 1):.1f} %",
    "image to pose": lambda each: _latency(each.pose),
    "odometry to\nbase pose": lambda each: _latency(each.base_pose),
    "memory, MB\nfirst, last": lambda each: f"{each.first_mb:.1f}  {each.last_mb:.1f}",
    "processor": lambda each: f"{100 * each.processor:.0f} %",
    "published\nlate, 99 %": lambda each: f"{each.late_p99_ms:.1f} ms",
}
