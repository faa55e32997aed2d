"""The textbook filter as a state-space model for the library `particles`, which runs it.

Source: Chopin and Papaspiliopoulos, "An Introduction to Sequential Monte Carlo", 2020, chapter 10; the library's own
`ssm.Bootstrap` and `SMC`. A particle is a row of 12 numbers: the rotation row by row, then the translation.
"""

from __future__ import annotations

import numpy as np
import particles  # pyright: ignore[reportMissingImports]
from jaxtyping import Float64
from particles import distributions, state_space_models  # pyright: ignore[reportMissingImports]

from filtering.motion import Odometry
from filtering.se3 import Poses
from vapor.benchmark.recordings.storage import from_rows, to_rows
from vapor.benchmark.textbook.building_blocks import (
    TextbookSettings,
    drawing_from,
    drawn,
    heaviest_place,
    log_likelihood,
    moved,
)

Rows = Float64[np.ndarray, "n 12"]


class ParticlesFilter:
    """See `TextbookFilter`; the library resamples where the effective sample size falls below half of the particles.

    Args:
        count: Number of particles.
        settings: Of the filter.
        flat_log_density: Of poses spread evenly over the map, per m³ rad³.
        rng: Source of all randomness.
    """

    def __init__(
        self, count: int, settings: TextbookSettings, flat_log_density: float, rng: np.random.Generator
    ) -> None:
        self._model = _Camera(settings=settings, flat=flat_log_density, rng=rng)
        self._model.seen = []
        self._rng = rng
        model = state_space_models.Bootstrap(ssm=self._model, data=self._model.seen)
        self._smc = particles.SMC(fk=model, N=count, resampling="systematic", ESSrmin=0.5, collect="off")

    def update(self, samples: Poses, odometry: Odometry) -> tuple[Poses, float]:
        """Take one image, see `TextbookFilter`."""
        self._model.seen.append((samples, odometry))
        with drawing_from(self._rng):
            next(self._smc)
        self._model.seen[-1] = None  # it is not asked for again, and a walk's samples would fill the memory
        return heaviest_place(from_rows(self._smc.X), self._smc.W)


class _Camera(state_space_models.StateSpaceModel):
    """A camera that moves as odometry says, and images of it; `seen` has samples and odometry of each image."""

    def PX0(self) -> _Law:
        """Where the camera is when the first image comes: where that image says."""
        return _Law(draw=lambda n: to_rows(drawn(self.seen[0][0], n, self.settings, self.rng)))

    def PX(self, t: int, xp: Rows) -> _Law:
        """Where it is after the motion to image t."""
        samples, odometry = self.seen[t]
        return _Law(draw=lambda n: to_rows(moved(from_rows(xp), odometry, samples, self.settings, self.rng)))

    def PY(self, t: int, xp: Rows | None, x: Rows) -> _Law:
        """What image t says; the first one has said it in `PX0`."""
        if t == 0:
            return _Law(fit=lambda _: np.zeros(len(x)))
        return _Law(fit=lambda seen: log_likelihood(seen[0], from_rows(x), self.settings, self.flat))


class _Law(distributions.ProbDist):
    """A distribution by how it is drawn from and by its log density, whichever is asked for."""

    dim = 12

    def __init__(self, draw=None, fit=None) -> None:
        self._draw, self._fit = draw, fit

    def rvs(self, size: int) -> Rows:
        """Draw rows (size, 12)."""
        return self._draw(size)

    def logpdf(self, seen) -> Float64[np.ndarray, " n"]:
        """Log density of what was seen for each particle, (n,)."""
        return self._fit(seen)
