"""How many particles a belief needs: KLD-sampling on cells of SE(3).

Source: Fox, "Adapting the sample size in particle filters through KLD-sampling", 2003.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from filtering.errors import require_within
from filtering.se3 import Poses


@dataclass(frozen=True)
class SampleSizeConfig:
    """Bounds of the number of particles, and how well they must stand for the belief."""

    min_particles: int = 1000
    """At least so many."""
    max_particles: int = 3000
    """At most so many, however wide the belief is."""
    cell_m: float = 0.5
    """Edge of a cell in translation, metres."""
    cell_rad: float = 0.5
    """Edge of a cell in rotation: change of a camera axis' direction, radians."""
    divergence: float = 0.05
    """Kullback-Leibler divergence, in nats, between the particles' histogram over cells and the belief's, at most."""
    confidence: float = 0.99
    """With this probability at least."""

    def __post_init__(self) -> None:
        require_within(
            self,
            max_particles=(1, 10**7),
            min_particles=(1, self.max_particles),
            cell_m=(1e-6, 1e6),
            cell_rad=(1e-3, 4.0),
            divergence=(1e-6, 1e3),
            confidence=(0.5, 0.999999),
        )

    def particles_needed(self, occupied_cells: int) -> int:
        """The number of particles for a belief that occupies so many cells (Fox 2003, eq. 7), within the bounds."""
        if occupied_cells < 2:
            return self.min_particles
        degrees = occupied_cells - 1
        # Wilson and Hilferty's approximation of the χ² quantile.
        share = 2 / (9 * degrees)
        chi_squared = degrees * (1 - share + np.sqrt(share) * ndtri(self.confidence)) ** 3
        needed = int(np.ceil(chi_squared / (2 * self.divergence)))
        return min(max(needed, self.min_particles), self.max_particles)


def occupied_cells(poses: Poses, config: SampleSizeConfig) -> int:
    """How many cells the poses (n,) lie in.

    A cell is a cube in translation and, in rotation, a cube each for the directions of the camera's x and z axes:
    unlike cells of Euler angles these have no poles, where cells shrink to nothing and one rotation has many. Zero is
    in the middle of a cell: level cameras and those at the origin do not lie where cells meet.
    """
    axes = poses.rotation[:, :, [0, 2]].reshape(-1, 6)
    cells = np.rint(np.concatenate([poses.translation / config.cell_m, axes / config.cell_rad], axis=1))
    return len(np.unique(np.clip(cells, -(2.0**62), 2.0**62).astype(np.int64) @ _MIXER))


# Odd numbers, wrapping around: two cells of a belief share one sum of products about once in 2⁶⁴ pairs.
_MIXER = np.random.default_rng(0).integers(-(2**63), 2**63 - 1, 9) | 1


def draw_enough(draw: Callable[[int], Poses], config: SampleSizeConfig) -> tuple[Poses, int]:
    """Draw poses for as many particles as the belief needs: again, and more, while they occupy too many cells for that.

    Args:
        draw: Draws the poses of a belief of so many particles.
        config: How many are needed.

    Returns:
        What was drawn last, and for how many particles.
    """
    size = config.min_particles
    poses = draw(size)
    while size < config.max_particles:
        needed = config.particles_needed(occupied_cells(poses, config))
        if needed <= size:
            break
        size = needed
        poses = draw(size)
    return poses, size
