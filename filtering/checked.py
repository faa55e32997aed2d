"""A posterior whose answers are checked: what a model gets wrong is named where it happens, not where it shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from filtering.errors import VaporTrackError
from filtering.posterior import DetailedPosterior, PosePosterior
from filtering.se3 import Poses


@dataclass(frozen=True)
class CheckedPosterior:
    """Passes every question on to a posterior and refuses answers that are none, naming method, value and place.

    Each method raises:
        VaporTrackError: the number of poses or values is not the one asked for, a pose is not finite, or a value is NaN
            or +∞. −∞ is a density of zero, and fine.
    """

    posterior: PosePosterior

    def sample(self, num_samples: int, *, rng: np.random.Generator) -> Poses:
        """As of the posterior, (num_samples,)."""
        poses = self.posterior.sample(num_samples, rng=rng)
        if poses.batch_shape != (num_samples,):
            raise VaporTrackError(
                f"sample of {self._name} returned poses of shape {poses.batch_shape}, expected ({num_samples},)"
            )
        finite = poses.is_finite()
        if not finite.all():
            first = int(np.argmin(finite))
            raise VaporTrackError(
                f"sample of {self._name} returned a pose that is not finite, number {first} of {num_samples}: "
                f"{poses[first].as_matrix()[:3].tolist()}"
            )
        return poses

    def log_density(self, poses: Poses) -> Float64[np.ndarray, " n"]:
        """As of the posterior, (n,)."""
        return self._values("log_density", self.posterior.log_density(poses), len(poses))

    def log_likelihood(self, poses: Poses) -> Float64[np.ndarray, " n"]:
        """As of the posterior, (n,)."""
        return self._values("log_likelihood", self.posterior.log_likelihood(poses), len(poses))

    def log_detail(self, poses: Poses) -> Float64[np.ndarray, " n"] | None:
        """As of the posterior, (n,); None where it has no such method or nothing to add."""
        if not isinstance(self.posterior, DetailedPosterior):
            return None
        values = self.posterior.log_detail(poses)
        return None if values is None else self._values("log_detail", values, len(poses))

    @property
    def _name(self) -> str:
        return type(self.posterior).__name__

    def _values(self, method: str, values: np.ndarray, count: int) -> np.ndarray:
        if np.shape(values) != (count,):
            raise VaporTrackError(
                f"{method} of {self._name} returned values of shape {np.shape(values)}, expected ({count},)"
            )
        bad = np.isnan(values) | (values == np.inf)
        if bad.any():
            first = int(np.argmax(bad))
            raise VaporTrackError(
                f"{method} of {self._name} is {values[first]} at pose {first} "
                f"({int(bad.sum())} of {count} are so), expected finite numbers or −∞"
            )
        return values
