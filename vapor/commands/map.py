"""`vapor-track map`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Annotated

import tyro

from sequences.datasets.listing import files_read
from sequences.mapping.config import MapConfig
from sequences.mapping.map import MapResult, map_images
from sequences.options import SequenceOptions
from vapor.commands.console import OutputPath, Overwrite, command_line, parse, show, show_notices
from vapor.commands.progress import progress


@dataclass(frozen=True)
class Options:
    """Find the poses of images alone, such as videos of a place, and write a folder that `train` reads."""

    inputs: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="INPUT ...")]
    """Videos, folders of images, data sets or recordings, all of one place. Their poses are in one frame."""
    output: OutputPath
    """Folder for the images with their poses, in COLMAP's layout, new or an earlier map."""
    overwrite: Overwrite = False
    config: Annotated[MapConfig, tyro.conf.arg(name="")] = field(default_factory=MapConfig)
    reading: Annotated[SequenceOptions, tyro.conf.arg(name="")] = field(default_factory=SequenceOptions)


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    o, command = parse("map", Options, arguments), command_line("map", arguments)
    with progress() as shown:
        result = map_images(
            o.inputs,
            o.output,
            o.config,
            reading=o.reading,
            command=command,
            overwrite=o.overwrite,
            reads=chain(o.reading.files_read, *(files_read(path) for path in o.inputs)),
            progress=lambda stage, done, total: shown.at(
                stage, done, total, unit="pairs" if stage == "matching pairs" else "images"
            ),
        )
    show(_summary(result, o.output))
    show_notices(result.notices)


def _summary(result: MapResult, output: Path) -> str:
    walks = ", ".join(f"{name} {placed} of {images}" for name, (placed, images) in result.walks.items())
    known = result.scale.source and f"metres, by {result.scale.source}"
    return "\n".join(
        [
            f"{output}: {result.placed} of {result.images} images have a pose ({walks}), {result.points} points,"
            f" {result.error_px:.2f} pixels off on average",
            f"unit: {known or 'arbitrary'}; z is up as the cameras were held",
        ]
    )
