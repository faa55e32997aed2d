"""LossConfig: the weights of the losses of all regressors. No torch is needed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from filtering.errors import VaporTrackError, require_within

PositionUnit = Literal["metre", "box"]


@dataclass(frozen=True)
class LossConfig:
    """Weights of the loss; the defaults of α, β and λ are the paper's, λ for its ambiguous scenes."""

    lambda_translation: float = 5.0
    """λ_t, per metre; with `position_unit` box, per metre along the longest edge."""
    position_unit: PositionUnit = "box"
    """Unit of errors of position: metre, as in the paper; or box, which multiplies the error along each axis by the
    longest edge of the scene's box over its own edge, up to ten, so that a height that varies little counts, too. In a
    mixture it affects the choice of the best component only, in a flow nothing."""
    lambda_rotation: float = 2.0
    """λ_r, per unit of ‖R̂ − R‖_F."""
    alpha: float = 0.2
    """Fraction of the samples that learn, the nearest to the true pose; at least one sample."""
    beta: float = 0.01
    """Weight of the KL divergence."""
    num_samples: int = 256
    """M, posterior samples per image; the paper draws 1000."""
    relative: float = 0.0
    """Weight of relative poses between pairs of images, for point regressors: MapNet."""
    pair_gap: int = 10
    """Greatest distance between the images of a pair, images."""

    def __post_init__(self) -> None:
        if self.position_unit not in get_args(PositionUnit):
            units = ", ".join(get_args(PositionUnit))
            raise VaporTrackError(f"loss: position_unit is {self.position_unit!r}, expected one of {units}")
        require_within(
            self,
            lambda_translation=(0.0, 1e9),
            lambda_rotation=(0.0, 1e9),
            alpha=(1e-6, 1.0),
            beta=(0.0, 1e9),
            num_samples=(1, 10**6),
            relative=(0.0, 1e9),
            pair_gap=(1, 10**6),
        )

    @property
    def num_winners(self) -> int:
        """⌊αM⌋, at least 1."""
        return max(1, int(self.alpha * self.num_samples + 1e-9))
