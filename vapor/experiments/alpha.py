"""How recall depends on α, the fraction of the samples that learn: the ablation of Zangeneh et al. (ICRA 2023)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import ClassVar

from filtering.errors import VaporTrackError
from vapor.experiments.sweep import SweepConfig
from vapor.training.config import TrainConfig
from vapor.training.presets import PRESETS

PAPER_ALPHAS = (0.01, *(round(0.05 * k, 2) for k in range(1, 21)))
"""α of the paper's figure."""


def _small_training() -> TrainConfig:
    """On all images, without calibration."""
    return replace(PRESETS["tables"], calibrate=False, validation_fraction=0.0)


@dataclass(frozen=True, kw_only=True)
class AlphaConfig(SweepConfig):
    """Settings of the experiment."""

    parameter: ClassVar[str] = "alpha"
    alphas: tuple[float, ...] = PAPER_ALPHAS
    """Fractions of the samples that learn."""
    train: TrainConfig = field(default_factory=_small_training)
    """How each network is trained; α and the seed are the experiment's. Three epochs are enough for the round table."""

    @property
    def values(self) -> tuple[float, ...]:
        """α."""
        return self.alphas

    def varied(self, value: float) -> TrainConfig:
        """The training with this α."""
        samples = self.train.loss.num_samples
        config = replace(self.train, loss=replace(self.train.loss, alpha=value))
        if value * samples < 1.0 - 1e-9:
            raise VaporTrackError(
                f"alpha {value} of {samples} samples leaves none to learn, expected at least {1 / samples:.3g}"
            )
        return config
