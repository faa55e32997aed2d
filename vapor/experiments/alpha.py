"""How recall depends on α, the share of the samples that learn: the ablation of Zangeneh et al. (ICRA 2023)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import ClassVar

from filtering.errors import VaporTrackError
from vapor.experiments.sweep import SweepConfig, small_training
from vapor.loss import LossConfig
from vapor.train_config import TrainConfig

PAPER_ALPHAS = (0.01, *(round(0.05 * k, 2) for k in range(1, 21)))
"""α of the paper's figure."""


def table_training() -> TrainConfig:
    """With what heights need to be learned, which vary little about the tables; small and fast."""
    small = small_training(8)
    return replace(
        small,
        network=replace(small.network, backbone="resnet18-quarter", shortcut=True),
        loss=LossConfig(position_unit="box", num_samples=100),
        initial_log_variance=-4.0,
        batch_size=32,
        learning_rate=3e-3,
    )


@dataclass(frozen=True, kw_only=True)
class AlphaConfig(SweepConfig):
    """Settings of the experiment."""

    parameter: ClassVar[str] = "alpha"
    alphas: tuple[float, ...] = PAPER_ALPHAS
    """Shares of the samples that learn."""
    train: TrainConfig = field(default_factory=table_training)
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
