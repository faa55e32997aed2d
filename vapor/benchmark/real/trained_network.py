"""Rows for which a model is trained on a part of the images, as `train` does by itself, and localizes in the rest."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool

from filtering.posterior import PosePosterior
from sequences.datasets.convert import convert
from sequences.odometry import OdometryNoise
from vapor.benchmark.real.row import Draw, Row, RowContext
from vapor.benchmark.recordings.record import record_file
from vapor.benchmark.recordings.storage import FileSettings, load_recording, seen_digest
from vapor.cache import code_digest, digest
from vapor.checkpoints.checkpoint import Checkpoint
from vapor.checkpoints.file_format import load_checkpoint
from vapor.tracking.follow import Segment
from vapor.training.config import TrainConfig
from vapor.training.presets import PRESETS
from vapor.training.train import train


@dataclass(frozen=True)
class TrainedNetwork(Row):
    """A model trained on some images of a place with the settings of `train`, localizing in the rest.

    Attributes:
        training: Folders of the data, `PATH@START:STOP`.
        dataset: Folder of the data with the images that are localized.
        frames: The first of them, and the one after the last; None: to the end.
        odometry: File of the data with recorded odometry; None: it is simulated.
        evaluated: Which of n images are evaluated, by a name for them.
        config: How to train: as `train` does without options.
    """

    training: tuple[str, ...]
    dataset: str
    frames: tuple[int, int | None] = (0, None)
    odometry: str | None = None
    evaluated: Mapping[str, Callable[[int], Bool[np.ndarray, " n"]]] = field(
        default_factory=lambda: {"": lambda n: np.ones(n, bool)}
    )
    config: TrainConfig = PRESETS["auto"]

    @property
    def simulated(self) -> bool:
        """Whether there are several draws of its odometry."""
        return self.odometry is None

    @property
    def needs(self) -> tuple[str, ...]:
        """Files and folders of the data that must be there."""
        folders = [entry.split("@")[0] for entry in self.training]
        return tuple(dict.fromkeys([*folders, self.dataset, *([self.odometry] if self.odometry else [])]))

    def prepare(self, context: RowContext, seed: int) -> dict[str, Any]:
        """Convert, train, and record the posterior of every image."""
        file, _ = self._sequence(context, seed)
        if not file.is_file():
            recorded = None if self.odometry is None else context.data / self.odometry
            noise = OdometryNoise() if recorded is None else None
            convert(
                context.data / self.dataset,
                file,
                odometry=recorded,
                odometry_noise=noise,
                frames=slice(*self.frames),
                seed=seed,
            )
        checkpoint = load_checkpoint(self._trained(context))
        return record_posteriors(context, self._recording(context, seed, checkpoint), file, checkpoint)

    def draw(self, context: RowContext, seed: int) -> Draw:
        """The posteriors of the network, and the odometry of the converted file."""
        checkpoint = load_checkpoint(self._trained(context))
        recording = load_recording(self._recording(context, seed, checkpoint), context.folder("recordings"))
        noise, truth = checkpoint.calibration.errors, recording.path.world_from_camera

        def posterior(image: int) -> PosePosterior:
            return recording.observed(image).posterior(checkpoint, noise)

        segment = Segment(recording.times_ns, recording.motions, truth, posterior)
        evaluated = {what: of(len(truth)) for what, of in self.evaluated.items()}
        return Draw(segment, noise, context.config.localizer, evaluated).with_model(checkpoint)

    @cached_property
    def _training_settings(self) -> dict[str, Any]:
        content = {"training": self.training, "config": self.config.settings(), "code": training_code()}
        return json.loads(json.dumps(content))

    def _trained(self, context: RowContext) -> Path:
        data = [context.data / entry for entry in self.training]
        return trained_model(
            context,
            self.name,
            self._training_settings,
            lambda file: train(data, file, self.config),
        )

    def _sequence(self, context: RowContext, seed: int) -> tuple[Path, str]:
        """The converted file, and a digest of its sources."""
        noise = asdict(OdometryNoise()) if self.odometry is None else self.odometry
        made = digest({"dataset": self.dataset, "frames": self.frames, "odometry": noise, "seed": seed})
        return context.folder("sequences") / f"{self.name}-{seed}-{made}.mcap", made

    def _recording(self, context: RowContext, seed: int, checkpoint: Checkpoint) -> FileSettings:
        file, made = self._sequence(context, seed)
        seen, c = seen_digest(checkpoint), context.config
        return FileSettings(file.stem, made, seen, seed, c.num_samples, precision=c.precision)


def trained_model(context: RowContext, name: str, settings: Mapping[str, Any], fit: Callable[[Path], object]) -> Path:
    """A model file, trained if it is not there; an interrupted training run continues.

    Args:
        context: Where it is.
        name: Of the row.
        settings: Everything that the model depends on, as JSON.
        fit: Trains, and writes the file.
    """
    file = context.folder("models") / f"{name}-{digest(settings)}.safetensors"
    if not file.is_file():
        fit(file)
    return file


def record_posteriors(
    context: RowContext, settings: FileSettings, file: Path, checkpoint: Checkpoint
) -> dict[str, Any]:
    """Record the posteriors of a file unless that is done; returns their settings, as JSON."""
    record_file(settings, file, checkpoint, context.folder("recordings"), engine=context.config.engine)
    return {"recording": settings.stored, "calibration": asdict(checkpoint.calibration)}


def training_code(*more: str) -> str:
    """Digest of the code that a model depends on, and of more of it."""
    return code_digest(
        *more,
        "sequences.odometry_fit",
        "vapor.cameras",
        "vapor.evaluation",
        "vapor.images",
        "vapor.calibration",
        "vapor.checkpoints",
        "vapor.landmarks",
        "vapor.regressors",
        "vapor.training",
        "vapor.training_data",
    )
