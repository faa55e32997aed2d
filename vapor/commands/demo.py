"""`vapor-track demo`: everything on one command, on a sequence rendered on the spot and a model that ships."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro
from tyro.extras import literal_type_from_choices

from sequences.errors import SequenceError
from sequences.outputs import results_folder
from sequences.scenes import SCENES
from sequences.synthesize import synthesize, write_synthetic
from vapor.checkpoints.file_format import shipped_models
from vapor.commands.console import OutputPath, Overwrite, command_line, parse, show, show_files, usage_error
from vapor.commands.progress import progress
from vapor.commands.terminal import results_are_complete
from vapor.pipeline.config import RunConfig
from vapor.pipeline.model import load_model
from vapor.pipeline.results import RESULTS
from vapor.pipeline.run import run_into
from vapor.reporting.report import format_table

_SEQUENCE = "sequence.mcap"

if TYPE_CHECKING:
    _Scene = str
else:  # those of which a model ships
    _Scene = literal_type_from_choices([name for name in SCENES if name in shipped_models()])


@dataclass(frozen=True)
class Options:
    """Synthesize a sequence, localize in it with the model that ships, and compare with single images."""

    scene: tyro.conf.Positional[_Scene] = "staircase"
    """The scene."""
    output: OutputPath | None = None
    """Directory for sequence and results, new or with earlier ones. Default: demo/SCENE."""
    overwrite: Overwrite = False
    seed: int = 1
    """Seed of the sequence and of the filter."""
    frames: int = 300
    """Number of images, ten a second."""


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    options = parse("demo", Options, arguments)
    output = options.output or Path("demo") / options.scene
    try:
        synthetic = synthesize(options.scene, seed=options.seed, num_frames=options.frames)
    except SequenceError as error:  # of numbers that no sequence can have
        usage_error("demo", str(error))
    with results_folder(output, "demo", writes=RESULTS | {_SEQUENCE}, overwrite=options.overwrite) as directory:
        with progress("rendering") as advance:
            write_synthetic(synthetic, directory / _SEQUENCE, progress=advance)
        with progress("localizing") as advance:
            config = RunConfig(seed=options.seed)
            model = load_model(options.scene, config)
            command = command_line("demo", arguments)
            result = run_into(directory, directory / _SEQUENCE, model, config, progress=advance, command=command)
    results_are_complete()
    show(format_table(result.report, title=f"{options.scene}, {result.report['frames']} synthetic images"))
    show_files(output, recording=True)
