"""Whether a constrained encoder turns confident posteriors into multimodal ones, as in Zangeneh et al., ICRA 2023.

Two walks are seen often enough to be learned by heart: a free encoder tells their images apart by chance differences
and is sure of one place in each. It is as sure, and mostly wrong, in images of another walk. Weight decay takes away
what that needs.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import ClassVar

from filtering.errors import require_within
from vapor.experiments.sweep import SweepConfig
from vapor.regressors.loss import LossConfig
from vapor.regressors.network_config import NetworkConfig
from vapor.training.config import TrainConfig


def _by_heart() -> TrainConfig:
    """Long enough to learn two walks by heart, by the paper's network and loss."""
    return TrainConfig(
        network=NetworkConfig(image_width=64, image_height=48, shortest_edge=52, shortcut=False),
        loss=LossConfig(position_unit="metre"),
        initial_log_variance=0.0,
        epochs=50,
        batch_size=16,
        learning_rate=1e-3,
        calibrate=False,
        validation_fraction=0.0,
    )


@dataclass(frozen=True, kw_only=True)
class DecayConfig(SweepConfig):
    """Settings of the experiment."""

    parameter: ClassVar[str] = "decay"
    decays: tuple[float, ...] = (0.0, 0.3, 1.0, 3.0, 10.0)
    """Weight decays of the encoder."""
    runs: int = 3
    """Training runs for each decay; they differ in initial weights, order, augmentation and latent noise."""
    sequences: int = 2
    """Walks about the table that are trained on."""
    frames: int = 500
    """Images of each."""
    training_images: int = 300
    """Images of those trained on that are evaluated as well, evenly spaced."""
    train: TrainConfig = field(default_factory=_by_heart)
    """How each network is trained; the encoder's weight decay and the seed are the experiment's."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_within(self, training_images=(1, 10**6))

    @property
    def values(self) -> tuple[float, ...]:
        """Weight decays."""
        return self.decays

    @property
    def also_evaluated(self) -> int:
        """Images of those trained on that are evaluated as well."""
        return self.training_images

    def varied(self, value: float) -> TrainConfig:
        """The training with this weight decay of the encoder."""
        return replace(self.train, encoder_weight_decay=value)
