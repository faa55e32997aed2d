"""`vapor-track run`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from sequences.options import SequenceOptions
from vapor.commands.console import bar, parse, show, show_files, show_notices, show_skipped
from vapor.report import format_table
from vapor.run import RunConfig, run


@dataclass(frozen=True)
class Options:
    """Localize the camera of a recorded sequence; write trajectories, report, pictures and recordings."""

    sequence: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="SEQUENCE")]
    """MCAP file or rosbag2 folder with images and odometry."""
    model: str
    """Model file, or name of a model that ships with the package: staircase, ceiling."""
    output: Path
    """Directory for the results."""
    reading: Annotated[SequenceOptions, tyro.conf.arg(name="")] = field(default_factory=SequenceOptions)
    config: Annotated[RunConfig, tyro.conf.arg(name="")] = field(default_factory=RunConfig)


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    options = parse("run", Options, arguments)
    with bar("localizing") as advance:
        result = run(
            options.sequence,
            options.model,
            options.output,
            options.config,
            reading=options.reading,
            progress=advance,
        )
    report = result.report
    if report["frames_with_true_pose"]:
        show(format_table(report, title=options.sequence.name))
    verdicts = ", ".join(f"{100 * share:.0f} % {verdict}" for verdict, share in report["status"].items())
    show(f"{report['frames']} images: {verdicts}")
    show_skipped(report["skipped"])
    show_notices(result.notices)
    show_files(options.output, result.pictures, recording=options.config.recording)
