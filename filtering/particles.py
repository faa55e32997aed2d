"""The belief: weighted particles on SE(3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from filtering.errors import VaporTrackError
from filtering.se3 import Poses


def log_sum(log_values: Float64[np.ndarray, " n"]) -> float:
    """Log of the sum of exp(values) (n,), n ≥ 1."""
    largest = float(log_values.max())
    if not np.isfinite(largest):
        return largest
    return largest + float(np.log(np.exp(log_values - largest).sum()))


def log_mean(log_values: Float64[np.ndarray, " n"], log_weights: Float64[np.ndarray, " n"] | None = None) -> float:
    """Log of the mean of exp(values) (n,), weighted by exp(weights), which need not be normalised; equal without."""
    if log_weights is None:
        return log_sum(log_values) - float(np.log(len(log_values)))
    return log_sum(log_values + log_weights) - log_sum(log_weights)


@dataclass(frozen=True)
class Particles:
    """Weighted samples of the belief.

    Attributes:
        poses: world_from_camera, batch (n,).
        log_weights: Log weights, normalised so that Σ exp = 1, (n,).
    """

    poses: Poses
    log_weights: Float64[np.ndarray, " n"]

    @staticmethod
    def from_unnormalised(poses: Poses, log_weights: Float64[np.ndarray, " n"]) -> tuple[Particles, float]:
        """Normalise importance weights.

        Returns:
            The particles, and the log of the mean unnormalised weight: the evidence, which normalising destroys.

        Raises:
            VaporTrackError: a weight is NaN or +∞, or all are zero.
        """
        bad = np.isnan(log_weights) | (log_weights == np.inf)
        if bad.any():
            first = int(np.argmax(bad))
            raise VaporTrackError(
                f"log weight of particle {first} is {log_weights[first]}, expected a finite number or −∞ "
                f"({int(bad.sum())} of {len(bad)} particles are so)"
            )
        total = log_sum(log_weights)
        if total == -np.inf:
            raise VaporTrackError(f"all {len(log_weights)} particle weights are zero, expected at least one positive")
        return Particles(poses, log_weights - total), total - float(np.log(len(log_weights)))

    @property
    def weights(self) -> Float64[np.ndarray, " n"]:
        """Normalised weights, (n,)."""
        return np.exp(self.log_weights)

    @property
    def effective_sample_size(self) -> float:
        """1 / Σ w², between 1 and n (Kong et al. 1994)."""
        return float(np.exp(-log_sum(2 * self.log_weights)))

    def __len__(self) -> int:
        return len(self.log_weights)

    def reweighted(self, log_factor: Float64[np.ndarray, " n"]) -> Particles:
        """The same particles with weights multiplied by exp(log_factor) (n,), normalised.

        Raises:
            VaporTrackError: as `from_unnormalised`.
        """
        return Particles.from_unnormalised(self.poses, self.log_weights + log_factor)[0]

    def keep_shares(self, of: Particles, label: Int64[np.ndarray, " n"]) -> Particles:
        """The same particles, every hypothesis with the share that it has among the weights of another belief.

        Args:
            of: The belief whose shares hold, over the same poses.
            label: Hypothesis of every particle, −1 where it belongs to none, (n,).
        """
        group = label + 1
        mine, its = np.bincount(group, self.weights), np.bincount(group, of.weights)
        known = mine > 1e-200 * its
        with np.errstate(divide="ignore"):
            log_factor = np.log(np.divide(its, mine, out=np.zeros_like(mine), where=known))
        # Where nothing is left of a hypothesis that has a share, the other belief's weights are all there is to say.
        log_weights = np.where(known[group], self.log_weights + log_factor[group], of.log_weights)
        return Particles(self.poses, log_weights - log_sum(log_weights))
