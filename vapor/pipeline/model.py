"""Models, loaded for runs."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

from vapor.checkpoints.shipped_models import find_model
from vapor.observation import VaporObservationModel
from vapor.pipeline.config import ModelConfig


@dataclass(frozen=True)
class LoadedModel:
    """A model ready for runs, whatever the number of sequences.

    Attributes:
        name: Name of its file, or the name it ships by.
        file: Path of its file.
        sha256: SHA-256 of its file.
        observation: The model itself.
    """

    name: str
    file: Path
    sha256: str
    observation: VaporObservationModel


def load_model(model: str, config: ModelConfig) -> LoadedModel:
    """Load a model file, or a model that ships by its name, for runs.

    Raises:
        VaporTrackError: no such model, an unusable file, or no such device.
    """
    checkpoint = find_model(model)
    observation = VaporObservationModel.from_checkpoint(
        str(checkpoint),
        num_samples=config.num_samples,
        device=config.device,
        engine=config.engine,
        precision=config.precision,
        threads=config.threads,
    )
    return LoadedModel(Path(model).name, checkpoint, hashlib.sha256(checkpoint.read_bytes()).hexdigest(), observation)
