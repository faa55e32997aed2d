"""How far figures over many runs are to be trusted: bootstrap intervals over the walks that the runs are cut from."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64

Interval = tuple[float, float]

_RESAMPLES = 1000
_TAILS = (2.5, 97.5)  # percentiles: 95 % lie between


class Walks:
    """The walks of n ≥ 1 runs, drawn a thousand times with replacement: all runs cut from a walk come with it.

    Intervals are percentiles of a figure over these draws (bootstrap of clusters: Davison and Hinkley, "Bootstrap
    Methods and Their Application", 1997, §3.8); the same runs give the same. They are None where fewer than two walks
    have a value. Where all walks agree they have no width, which is no proof: see `dissent`.

    Args:
        walks: Which walk each run is cut from, (n,).
    """

    def __init__(self, walks: Sequence[int]) -> None:
        self._walk = np.unique(walks, return_inverse=True)[1]
        every = self.count
        drawn = np.random.default_rng(0).multinomial(every, np.full(every, 1.0 / every), size=_RESAMPLES)
        self._times = drawn[:, self._walk]  # how often each run is in each draw

    @property
    def count(self) -> int:
        """How many walks there are."""
        return int(self._walk.max()) + 1

    def mean(
        self, values: Sequence[int | float | None], weights: Sequence[int | float] | None = None
    ) -> Interval | None:
        """Interval of the mean of the runs' values (n,), weighted if asked for; runs without a value do not count."""
        known = np.array([value is not None for value in values])
        weight = known * (1.0 if weights is None else np.array(weights))
        total = self._times @ weight
        of_draws = self._times @ (weight * np.array([value or 0.0 for value in values]))
        return self._interval(known, of_draws[total > 0] / total[total > 0])

    def number(self, flags: Sequence[bool]) -> Interval | None:
        """Interval of how many of the runs have a flag, (n,)."""
        fraction = self.mean(flags)
        return None if fraction is None else (len(flags) * fraction[0], len(flags) * fraction[1])

    def median(self, values: Sequence[int | float | None]) -> Interval | None:
        """Interval of the median of the runs' values (n,); runs without one do not count."""
        known = np.array([value is not None for value in values])
        numbers = np.array([value for value in values if value is not None], np.float64)
        order = np.argsort(numbers)
        up_to = np.cumsum(self._times[:, known][:, order], axis=1)
        up_to = up_to[up_to.any(axis=1)]
        total = up_to[:, -1:]
        middle = [(up_to <= rank).sum(axis=1) for rank in ((total - 1) // 2, total // 2)]
        return self._interval(known, numbers[order][np.array(middle)].mean(axis=0))

    def _interval(self, known: np.ndarray, of_draws: Float64[np.ndarray, " k"]) -> Interval | None:
        if len(np.unique(self._walk[known])) < 2:
            return None
        low, high = np.percentile(of_draws, _TAILS)
        return float(low), float(high)


def dissent(walks: int) -> float:
    """The largest fraction of walks that are otherwise, with 95 % confidence, where so many agree: about 3 in n."""
    return 1.0 - 0.05 ** (1.0 / walks)
