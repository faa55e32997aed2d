"""`vapor-track inspect`."""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Annotated

import tyro

from filtering.errors import VaporTrackError, shortened
from sequences.datasets.points import scene_points
from sequences.frame import Frame
from sequences.options import SequenceOptions
from sequences.outputs import results_folder
from vapor.checkpoints.file_format import find_model
from vapor.commands.console import OutputPath, Overwrite, command_line, parse, show, usage_error
from vapor.commands.inspect_tables import parts, show_inspection
from vapor.commands.progress import progress
from vapor.commands.terminal import write
from vapor.engines.engine import Device, EngineConfig
from vapor.inspection.inspect import Inspection, inspect
from vapor.inspection.picture import draw_map
from vapor.inspection.recording import record_coverage
from vapor.observation import VaporObservationModel
from vapor.reporting.html.page import Page, findings_page, write_page
from vapor.reporting.record import EvenlySpaced
from vapor.reporting.report import write_report
from vapor.reporting.rerun_shapes import SMALL_SIDE, Photograph
from vapor.training_data.entries import files_read, name_entries

_MAP, _RECORDING, _REPORT, _PAGE = "map.png", "recording.rrd", "report.json", "report.html"
_MOST_PHOTOGRAPHS = 150  # Rerun keeps each apart, and of more in one place all are selected
_FILES = (_MAP, _RECORDING, _REPORT, _PAGE)


@dataclass(frozen=True)
class Options:
    """Judge whether recordings are good enough to train on, and what to record again."""

    data: Annotated[tyro.conf.Positional[tuple[str, ...]], tyro.conf.arg(metavar="DATA ...")]
    """MCAP files, rosbag2 folders, data set folders or files that list a split; PATH@START:STOP takes only those images
    of it."""
    model: str | None = None
    """Model file, or name of a model that ships with the package: report, too, where it is unsure or wrong."""
    output: OutputPath | None = None
    """Folder for report.html, report.json and, where there are true poses, map.png and recording.rrd; new or with
    earlier ones."""
    recording: bool = True
    """Write recording.rrd for the Rerun viewer: where the cameras were, and where the model puts them."""
    overwrite: Overwrite = False
    json: bool = False
    """Print the report as JSON instead."""
    num_samples: int = 300
    """Posterior samples an image, with a model."""
    seed: int = 0
    """Of the samples."""
    device: Device = "auto"
    """Where the network runs."""
    network: Annotated[EngineConfig, tyro.conf.arg(name="")] = field(default_factory=EngineConfig)
    reading: Annotated[SequenceOptions, tyro.conf.arg(name="")] = field(default_factory=SequenceOptions)

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise VaporTrackError(f"seed is {self.seed}, expected a number from 0")


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    o = parse("inspect", Options, arguments)
    if not o.data:
        usage_error("inspect", "no data, expected at least one file or folder")
    with _outputs(o) as directory:
        model = None
        if o.model is not None:
            model = VaporObservationModel.from_checkpoint(
                o.model,
                num_samples=o.num_samples,
                device=o.device,
                engine=o.network.engine,
                precision=o.network.precision,
            )
        photographs: EvenlySpaced[Photograph] = EvenlySpaced(_MOST_PHOTOGRAPHS)

        def see(frame: Frame) -> None:
            if o.recording and directory is not None and frame.world_from_camera is not None:
                photographs.add(lambda: Photograph.of(frame, SMALL_SIDE))

        with progress() as shown:
            found = inspect(o.data, o.reading, model=model, seed=o.seed, see=see, progress=shown.at)
        if directory is not None:
            if found.coverage is not None:
                draw_map(directory / _MAP, found.coverage)
                if o.recording:
                    points = [scene_points(path) for path, _ in name_entries(o.data).values()]
                    record_coverage(
                        directory / _RECORDING,
                        found.coverage,
                        photographs.kept,
                        found.predictions,
                        points=[each for each in points if each is not None],
                    )
            write_report(directory / _REPORT, found.as_json())
            write_page(directory / _PAGE, _page(found, o, directory / _MAP, command_line("inspect", arguments)))
    if o.json:
        write(json.dumps(found.as_json(), indent=2, sort_keys=True, allow_nan=False))
        return
    show_inspection(found)
    if o.output is not None:
        for name in (_MAP,) * (found.coverage is not None) + (_REPORT, _PAGE):
            show(f"{o.output / name}")
        if found.coverage is not None and o.recording:
            show(f"rerun {o.output / _RECORDING}")


def _page(found: Inspection, o: Options, picture: Path, command: str) -> Page:
    *found_parts, _ = parts(found)  # the last is the verdict
    seen = [("From above", [picture])] if found.coverage is not None else []
    asked = "Was it recorded well enough to train on, and what to record again?"
    first, *others = found.verdict
    rest = [("What else to do", [f"{number}. {sentence}" for number, sentence in enumerate(others, 2)])]
    title = ", ".join(Path(entry).name for entry in o.data)
    return findings_page(
        shortened(title, 100), asked, f"{first[0].upper()}{first[1:]}.", [*rest, *seen, *found_parts], command=command
    )


def _outputs(o: Options) -> AbstractContextManager[Path | None]:
    if o.output is None:
        return nullcontext()
    reads = chain([] if o.model is None else [find_model(o.model)], files_read(o.data, o.reading))
    return results_folder(o.output, "inspect", writes=_FILES, reads=reads, overwrite=o.overwrite)
