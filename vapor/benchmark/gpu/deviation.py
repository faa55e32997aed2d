"""How far two computations of the same posterior samples differ."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from vapor.benchmark.gpu.stages import Finding

_MOST_SAMPLES = 95.0  # percentile: one to three per cent lie between places, where rounding moves them far


@dataclass(frozen=True)
class Tolerance:
    """Greatest deviations that pass: of a position, metres, a rotation, degrees, and a log density, nats."""

    metres: float
    degrees: float
    nats: float


def sample_deviation(
    what: str,
    one: tuple[Float[np.ndarray, "*n 3"], Float[np.ndarray, "*n 3 3"]],
    other: tuple[Float[np.ndarray, "*n 3"], Float[np.ndarray, "*n 3 3"]],
    tolerance: Tolerance | None = None,
) -> Iterator[Finding]:
    """The deviations that nearly all samples have at most: positions and rotation matrices of the same noise."""
    apart = [a.astype(np.float64) - b.astype(np.float64) for a, b in zip(one, other, strict=True)]
    metres = np.linalg.norm(apart[0], axis=-1)
    # Not by the trace: of float32 matrices that is blind to less than 0.02°.
    chord = np.linalg.norm(apart[1], axis=(-2, -1)) / np.sqrt(8.0)
    degrees = np.degrees(2.0 * np.arcsin(np.minimum(chord, 1.0)))
    for part, values, unit in (("position", 1e3 * metres, "mm"), ("rotation", degrees, "°")):
        most = None if tolerance is None else 1e3 * tolerance.metres if unit == "mm" else tolerance.degrees
        note = f"{_MOST_SAMPLES:.0f} % of the samples; greatest {values.max():.3g} {unit}"
        yield Finding(f"{what}: {part}", float(np.percentile(values, _MOST_SAMPLES)), unit, most=most, note=note)
