"""Rows for which a model is trained on a part of the images, as `train` does by itself, and localizes in the rest."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool

from filtering.config import LocalizerConfig
from filtering.posterior import PosePosterior
from sequences.datasets.convert import convert
from sequences.odometry import OdometryNoise
from vapor.benchmark.real.row import Draw, RowContext
from vapor.benchmark.recordings.record import record_file
from vapor.benchmark.recordings.storage import FileSettings, Recording, load_recording, not_recorded, seen_digest
from vapor.cache import code_digest, digest
from vapor.checkpoints.checkpoint import Checkpoint
from vapor.checkpoints.file_format import load_checkpoint
from vapor.landmarks.verify import verified
from vapor.storage import fetched, published, withdrawn
from vapor.tracking.follow import Segment, posterior_of
from vapor.training.config import TrainConfig
from vapor.training.presets import PRESETS
from vapor.training.progress import ProgressCallback
from vapor.training.state import state_path
from vapor.training.train import train


@dataclass(frozen=True)
class TrainedNetwork:
    """A model trained on some images of a place with the settings of `train`, localizing in the rest.

    Attributes:
        training: Folders of the data, `PATH@START:STOP`.
        dataset: Folder of the data with the images that are localized.
        frames: The first of them, and the one after the last; None: to the end.
        odometry: File of the data with recorded odometry; None: it is simulated.
        evaluated: Which of n images are evaluated, by a name for them.
        config: How to train: as `train` does without options.
    """

    name: str
    training: tuple[str, ...]
    dataset: str
    frames: tuple[int, int | None] = (0, None)
    odometry: str | None = None
    evaluated: Mapping[str, Callable[[int], Bool[np.ndarray, " n"]]] = field(
        default_factory=lambda: {"": lambda n: np.ones(n, bool)}
    )
    config: TrainConfig = PRESETS["auto"]

    @property
    def group(self) -> str:
        """A group of its own."""
        return self.name

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
        if not fetched(file).is_file():
            context.advance("converting", seed, None)
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
            published(file)
        checkpoint = load_checkpoint(self._trained(context))
        return record_posteriors(context, self._recording(context, seed, checkpoint), lambda: file, checkpoint, seed)

    def draw(self, context: RowContext, seed: int, config: LocalizerConfig) -> Draw:
        """The posteriors of the network, and the odometry of the converted file."""
        checkpoint = load_checkpoint(self._trained(context))
        recording = load_recording(self._recording(context, seed, checkpoint), context.folder("recordings"))
        errors, fit = checkpoint.calibration.errors, checkpoint.calibration.odometry
        posterior, n = posterior_of_recorded(recording, checkpoint), len(recording.times_ns)
        truth, odometry = recording.path.world_from_camera, tuple(recording.motion(i) for i in range(n))
        return Draw(
            Segment(recording.times_ns, odometry, truth, posterior).restated(fit),
            errors,
            config if fit is None else replace(config, odometry_bias=fit.odometry_bias),
            {what: of(n) for what, of in self.evaluated.items()},
        )

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
            lambda file, report: train(data, file, self.config, progress=report),
        )

    def _sequence(self, context: RowContext, seed: int) -> tuple[Path, str]:
        """The converted file, and a digest of its sources."""
        noise = asdict(OdometryNoise()) if self.odometry is None else self.odometry
        made = digest({"dataset": self.dataset, "frames": self.frames, "odometry": noise, "seed": seed})
        return context.folder("sequences") / f"{self.name}-{seed}-{made}.mcap", made

    def _recording(self, context: RowContext, seed: int, checkpoint: Checkpoint) -> FileSettings:
        file, made = self._sequence(context, seed)
        digests, precision = (made, seen_digest(checkpoint)), context.network.precision
        return FileSettings(file.stem, *digests, seed, context.num_samples, precision=precision)


def trained_model(
    context: RowContext, name: str, settings: Mapping[str, Any], fit: Callable[[Path, ProgressCallback], object]
) -> Path:
    """A model file, trained if it is not there; an interrupted training run continues.

    Args:
        context: Where it is.
        name: Of the row.
        settings: Everything that the model depends on, as JSON.
        fit: Trains, and writes the file.
    """
    file = context.folder("models") / f"{name}-{digest(settings)}.safetensors"
    if not fetched(file).is_file():
        fetched(state_path(file))
        fit(file, lambda progress: context.advance(progress.stage, progress.done, progress.total))
        published(file)
        withdrawn(state_path(file))
    return file


def record_posteriors(
    context: RowContext, settings: FileSettings, file: Callable[[], Path], checkpoint: Checkpoint, seed: int
) -> dict[str, Any]:
    """Record the posteriors of a file unless that is done; returns their settings, as JSON."""
    recordings = context.folder("recordings")
    if not_recorded([settings], recordings):
        context.advance("computing posteriors", seed, None)
        record_file(settings, file(), checkpoint, recordings, engine=context.network.engine)
    return {"recording": settings.stored, "calibration": asdict(checkpoint.calibration)}


def posterior_of_recorded(recording: Recording, checkpoint: Checkpoint) -> Callable[[int], PosePosterior]:
    """The posterior of an image of a recording, by its number."""
    errors, landmarks = checkpoint.calibration.errors, checkpoint.landmarks

    def posterior(image: int) -> PosePosterior:
        coarse = posterior_of(recording.posterior_poses(image), errors, float(recording.ood_score[image]))
        if landmarks is None:
            return coarse
        return verified(coarse, recording.verified[image], landmarks.verification, landmarks.mapped)

    return posterior


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
