"""Reliability of stated probabilities: how often what is stated with a probability is right."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64

_BINS = 10


@dataclass(frozen=True)
class ReliabilityBin:
    """Images whose best place has a stated probability in the same range.

    Attributes:
        low, high: The range.
        images: Their number, of which `effective_images` are independent.
        stated: Mean stated probability of the best place.
        right: Fraction of them of which it is the true place.
    """

    low: float
    high: float
    images: int
    effective_images: float
    stated: float
    right: float


@dataclass(frozen=True)
class Reliability:
    """A reliability diagram: how often the best place is the true one, by its stated probability.

    `expected_error` is the expected calibration error: the mean distance of the two, by the number of images.
    """

    bins: tuple[ReliabilityBin, ...]
    expected_error: float

    @staticmethod
    def of(stated: Float64[np.ndarray, " n"], right: Bool[np.ndarray, " n"], worth: float = 1.0) -> Reliability:
        """Of n images, n ≥ 1, each worth so many independent ones."""
        number = np.minimum((stated * _BINS).astype(np.int64), _BINS - 1)
        bins = tuple(
            ReliabilityBin(
                low=k / _BINS,
                high=(k + 1) / _BINS,
                images=int(inside.sum()),
                effective_images=worth * float(inside.sum()),
                stated=float(stated[inside].mean()),
                right=float(right[inside].mean()),
            )
            for k, inside in enumerate(number == np.arange(_BINS)[:, None])
            if inside.any()
        )
        return Reliability(bins, sum(each.images * abs(each.stated - each.right) for each in bins) / len(stated))

    @property
    def right(self) -> float:
        """Fraction of all images whose best place is the true one."""
        return sum(each.images * each.right for each in self.bins) / sum(each.images for each in self.bins)

    def as_json(self) -> dict[str, dict[str, Any]]:
        """For a report: by the lower end of a range, the number of `images`, the mean `stated`, and what is `right`."""
        return {
            f"{each.low:.1f}": {"images": each.images, "stated": each.stated, "right": each.right} for each in self.bins
        }
