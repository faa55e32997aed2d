"""What a method believes after each image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from filtering.estimate import Mode, Status
from filtering.se3 import Poses


@dataclass(frozen=True)
class Belief:
    """What a method believed after each of n images.

    Attributes:
        modes: Hypotheses per image, the reported one first.
        status: Its own status per image.
    """

    modes: Sequence[tuple[Mode, ...]]
    status: Sequence[Status]

    @property
    def best(self) -> Poses:
        """The reported poses, world_from_camera, batch (n,)."""
        return Poses.stack([modes[0].world_from_camera for modes in self.modes])


def mode_status(mode: Mode, converged_std_m: float, converged_weight: float) -> Status:
    """The status of a baseline, by what of the filter's rule it has: the weight of its best mode, and its position."""
    sure = mode.widest_std_m <= converged_std_m and mode.weight >= converged_weight
    return "converged" if sure else "ambiguous"
