"""`vapor-track fuse`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from sequences.estimates.sequence import EstimateOptions
from vapor.commands.console import OutputPath, Overwrite, command_line, parse, usage_error
from vapor.commands.progress import progress
from vapor.commands.run import show_run
from vapor.pipeline.config import FilteringConfig
from vapor.pipeline.fuse import EstimateConfig, fuse


@dataclass(frozen=True)
class Options:
    """Localize a camera from pose estimates of others, given as text, and odometry; no images needed.

    Files hold lines of `name qw qx qy qz tx ty tz`, in any order, or a TUM trajectory, `time tx ty tz qx qy qz qw`, or
    other --columns. Where these have a weight, such as the number of inliers, a frame may have several hypotheses.
    """

    estimates: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="ESTIMATES ...")]
    """Files of pose estimates, one for each method; each has one hypothesis of where the camera is, or
    several with weights."""
    output: OutputPath
    """Directory for the results, new or with earlier ones."""
    overwrite: Overwrite = False
    odometry: Path | None = None
    """Recorded odometry: poses of the camera in any frame, of which only the relative motion counts."""
    simulate_odometry: Path | None = None
    """True poses to simulate odometry from, with the noise below, where there is none."""
    ground_truth: Path | None = None
    """True poses to compare with. Default: those that odometry is simulated from."""
    trust: Annotated[EstimateConfig, tyro.conf.arg(name="")] = field(default_factory=EstimateConfig)
    reading: Annotated[EstimateOptions, tyro.conf.arg(name="")] = field(default_factory=EstimateOptions)
    config: Annotated[FilteringConfig, tyro.conf.arg(name="")] = field(default_factory=FilteringConfig)


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    o = parse("fuse", Options, arguments)
    if (o.odometry is None) == (o.simulate_odometry is None):
        given = "no odometry" if o.odometry is None else "two odometries"
        usage_error("fuse", f"{given}, expected either --odometry FILE or --simulate-odometry FILE")
    with progress("localizing") as advance:
        result = fuse(
            o.estimates,
            o.output,
            o.config,
            odometry=o.odometry,
            simulate_odometry=o.simulate_odometry,
            ground_truth=o.ground_truth,
            trust=o.trust,
            reading=o.reading,
            overwrite=o.overwrite,
            progress=advance,
            command=command_line("fuse", arguments),
        )
    title = ", ".join(path.name for path in o.estimates)
    show_run(result, o.output, title=title, recording=o.config.recording, large_errors=True)
