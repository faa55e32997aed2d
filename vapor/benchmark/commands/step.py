"""`vapor-benchmark step`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import islice
from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.table import Table

from filtering.errors import VaporTrackError, require_within
from sequences.frame import Camera, Frame
from sequences.reader import SequenceReader
from vapor.benchmark import PROGRAM
from vapor.benchmark.commands.options import SummaryPath, claim_summary, require_each_once, write_rows
from vapor.benchmark.step_times import time_step
from vapor.benchmark.untrained import untrained
from vapor.commands.console import parse, show
from vapor.commands.model_name import ModelName
from vapor.engines.engine import Device, EngineConfig
from vapor.observation import VaporObservationModel
from vapor.threads import limited_threads
from vapor.training.presets import PRESETS

_IMAGES = 100  # of a recording at most: they are decoded before
_Way = Literal["auto", "torch", "torch-bfloat16", "openvino", "openvino-bfloat16"]
_WAYS: Mapping[_Way, EngineConfig] = {
    "auto": EngineConfig(),
    "torch": EngineConfig("torch"),
    "torch-bfloat16": EngineConfig("torch", "bfloat16"),
    "openvino": EngineConfig("openvino"),
    "openvino-bfloat16": EngineConfig("openvino", "bfloat16"),
}


@dataclass(frozen=True)
class Options:
    """Time the parts of a step: decoding, network, landmarks, filter."""

    model: ModelName = "staircase"
    """Model file, or name of a model that ships with the package."""
    preset: Annotated[str | None, tyro.conf.arg(metavar=f"{{{','.join(PRESETS)}}}")] = None
    """Time the network of this preset of `train` instead, with random weights and without the filter."""
    engines: tuple[_Way, ...] = ("auto",)
    """What runs the network, each for itself, by turns; see `run --engine` and `--precision`."""
    device: Device = "auto"
    """Where the network runs."""
    sequence: Path | None = None
    """Recording of the place of the model: also time whole steps on its first images, image bytes to estimate."""
    num_samples: int = 1000
    """Posterior samples per image."""
    hypotheses: tuple[int, ...] = (1000,)
    """Sizes of beliefs that the filter is timed with beside the usual one: so many hypotheses, none merged."""
    threads: int = 1
    """Processor threads of the network."""
    repetitions: int = 50
    """How often every part is timed."""
    summary: SummaryPath = None

    def __post_init__(self) -> None:
        require_within(self, **dict.fromkeys(("num_samples", "threads", "repetitions"), (1, 10**6)))
        if self.preset is not None and self.preset not in PRESETS:
            raise VaporTrackError(f"unknown preset {self.preset!r}, expected one of {', '.join(PRESETS)}")
        require_each_once("engines", self.engines)
        if self.sequence is not None and self.preset is not None:
            raise VaporTrackError("sequence and preset, expected one of them: random weights find no place")
        if not self.hypotheses or min(self.hypotheses) < 1:
            raise VaporTrackError(f"hypotheses are {self.hypotheses}, expected numbers of at least 1")


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    o = parse("step", Options, arguments, program=PROGRAM)
    claim_summary(o.summary)
    frames, camera = ([], None) if o.sequence is None else _frames(o.sequence)
    table = Table("part of a step", "median ms", "95 % ms", "99 % ms")
    with limited_threads(o.threads):
        timings = time_step(
            _models(o, camera),
            repetitions=o.repetitions,
            hypotheses=o.hypotheses if o.preset is None else (),
            frames=frames,
        )
    for timing in timings:
        table.add_row(timing.part, f"{timing.median_ms:.2f}", f"{timing.p95_ms:.2f}", f"{timing.p99_ms:.2f}")
    show(table)
    write_rows(o.summary, map(asdict, timings))


def _models(o: Options, camera: Camera | None) -> dict[str, VaporObservationModel]:
    """The network by each way to run it; two that turn out to be the same are one."""
    network = o.model if o.preset is None else untrained(PRESETS[o.preset].network)
    models = {}
    for way in o.engines:
        asked = _WAYS[way]
        model = VaporObservationModel.from_checkpoint(
            network,
            num_samples=o.num_samples,
            device=o.device,
            camera=camera,
            engine=asked.engine,
            precision=asked.precision,
            threads=o.threads,
        )
        precise = "" if asked.precision == "float32" else f" in {asked.precision}"
        where = "" if model.engine.device == "cpu" else f" on {model.engine.device}"
        models[f"{model.engine.name}{precise}{where}"] = model
    return models


def _frames(recording: Path) -> tuple[list[Frame], Camera | None]:
    reader = SequenceReader(recording)
    frames = list(islice(reader, _IMAGES))
    if not frames:
        raise VaporTrackError(f"{recording}: no images, expected one to time a step on")
    return frames, reader.camera
