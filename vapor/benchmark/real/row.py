"""Input and output of the rows of `vapor-benchmark real`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Bool

from filtering.config import LocalizerConfig
from filtering.errors import VaporTrackError
from filtering.measurement_noise import MeasurementNoise
from vapor.engines.engine import EngineConfig
from vapor.tracking.follow import Segment

Advance = Callable[[str, int, int | None], None]
"""Called with the name of the work, the amount done, and the total."""


@dataclass(frozen=True)
class RowContext:
    """Where a row finds its data and stores its results.

    Attributes:
        data: Folder with the recordings of others.
        output: Folder for models, sequences, recordings and results.
    """

    data: Path
    output: Path
    num_samples: int = 1000
    network: EngineConfig = field(default_factory=EngineConfig)
    advance: Advance = field(default=lambda what, done, total: None, compare=False)

    def folder(self, name: str) -> Path:
        """A folder in the output, made if absent."""
        folder = self.output / name
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise VaporTrackError(
                f"{folder}: cannot write: {error.strerror or error}, expected a directory that can be written to"
            ) from error
        return folder


@dataclass(frozen=True)
class Draw:
    """One draw of a row, ready to be localized.

    Attributes:
        segment: n images.
        errors: How they err.
        localizer: Settings of the filter.
        evaluated: Which images are evaluated, (n,), by a name for them; the empty name is the row itself.
        unit_m: Lengths are evaluated in units of so many metres.
        in_sequences: Whether short sequences of it are localized too, each from the beginning.
    """

    segment: Segment
    errors: MeasurementNoise
    localizer: LocalizerConfig
    evaluated: Mapping[str, Bool[np.ndarray, " n"]]
    unit_m: float = 1.0
    in_sequences: bool = True
