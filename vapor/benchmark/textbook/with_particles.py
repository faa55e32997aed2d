"""The textbook filter as a state-space model for the library `particles`, which runs it.

Source: Chopin and Papaspiliopoulos, "An Introduction to Sequential Monte Carlo", 2020, chapter 10; the library's own
`ssm.Bootstrap` and `SMC`. A particle is a row of 12 numbers: the rotation row by row, then the translation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

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
Seen = tuple[Poses, Odometry]
"""Samples of an image, and the motion before it."""


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
        self._rng = rng
        self._seen: list[Seen | None] = []
        camera = _Camera(self._seen, settings, flat_log_density, rng)
        model = state_space_models.Bootstrap(ssm=camera, data=self._seen)
        self._smc = particles.SMC(fk=model, N=count, resampling="systematic", ESSrmin=0.5, collect="off")

    def update(self, samples: Poses, odometry: Odometry) -> tuple[Poses, float]:
        """Take one image, see `TextbookFilter`."""
        self._seen.append((samples, odometry))
        with drawing_from(self._rng):
            next(self._smc)
        self._seen[-1] = None  # it is not asked for again, and a walk's samples would fill the memory
        return heaviest_place(from_rows(np.asarray(self._smc.X)), self._smc.W)


class _Camera(state_space_models.StateSpaceModel):
    """A camera that moves as odometry says, and what its images say; the last of `seen` is the image now."""

    def __init__(
        self, seen: Sequence[Seen | None], settings: TextbookSettings, flat: float, rng: np.random.Generator
    ) -> None:
        super().__init__()
        self._seen, self._settings, self._flat, self._rng = seen, settings, flat, rng

    def PX0(self) -> _Drawn:
        """Where the camera is when the first image comes: where that image says."""
        return _Drawn(lambda count: to_rows(drawn(self._now(0)[0], count, self._settings, self._rng)))

    def PX(self, t: int, xp: Rows) -> _Drawn:
        """Where it is after the motion to image t."""
        samples, odometry = self._now(t)
        return _Drawn(lambda _: to_rows(moved(from_rows(xp), odometry, samples, self._settings, self._rng)))

    def PY(self, t: int, xp: Rows | None, x: Rows) -> _Fit:
        """What image t says; the first one has said it in `PX0`."""
        samples, _ = self._now(t)
        if t == 0:
            return _Fit(lambda: np.zeros(len(x)))
        return _Fit(lambda: log_likelihood(samples, from_rows(x), self._settings, self._flat))

    def _now(self, t: int) -> Seen:
        seen = self._seen[t]
        assert seen is not None
        return seen


class _Drawn(distributions.ProbDist):
    """A distribution of rows that one can draw from."""

    dim = 12

    def __init__(self, draw: Callable[[int], Rows]) -> None:
        self._draw = draw

    def rvs(self, size: int | None = None) -> Rows:
        """Rows (size, 12)."""
        return self._draw(size or 1)


class _Fit(distributions.ProbDist):
    """A distribution of what is seen, given each of n particles, by its density at what was seen."""

    def __init__(self, log_density: Callable[[], Float64[np.ndarray, " n"]]) -> None:
        self._log_density = log_density

    def logpdf(self, x: object) -> Float64[np.ndarray, " n"]:
        """Log density of what was seen, (n,)."""
        return self._log_density()
