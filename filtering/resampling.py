"""Resampling: fewer weighted particles."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Literal

import numpy as np
from jaxtyping import Float64, Int64

Resampling = Literal["optimal", "heaviest"]


def copied(rng: np.random.Generator) -> np.random.Generator:
    """A generator that draws what this one would draw next; several times faster than `copy.deepcopy`."""
    bits = type(rng.bit_generator)(0)
    bits.state = rng.bit_generator.state
    return np.random.Generator(bits)


def systematic(weights: Float64[np.ndarray, " n"], count: int, *, rng: np.random.Generator) -> Int64[np.ndarray, " k"]:
    """Indices (k,) drawn in proportion to weights (n,), which need not be normalised: one random number, even steps."""
    cumulative = np.cumsum(weights)
    points = (np.arange(count) + rng.random()) * (cumulative[-1] / count)
    return np.minimum(np.searchsorted(cumulative, points, side="right"), len(weights) - 1)


def optimal_resample(
    log_weights: Float64[np.ndarray, " n"], count: int, *, rng: np.random.Generator
) -> tuple[Int64[np.ndarray, " k"], Float64[np.ndarray, " k"]]:
    """Optimal resampling (Fearnhead and Clifford, 2003): of all unbiased ways, the one of least variance.

    Those above a threshold are kept with their weights; of the others some are drawn, each with the threshold for a
    weight. No particle is drawn twice, and the expected weight of each is what it was.

    Args:
        log_weights: Normalised, (n,), n > count.
        count: Number kept, at least 1.
        rng: Source of the draw.

    Returns:
        Indices of those kept, and their log weights, (k,).
    """
    order = np.argsort(-log_weights, kind="stable")
    weights = np.exp(log_weights[order])
    rest = np.cumsum(weights[::-1])[::-1]  # of each and all lighter ones
    # The first number of heavy ones at which the others, spread evenly over the places left, are no heavier.
    places = count - np.arange(count)
    heavy = int(np.argmax(weights[:count] * places <= rest[:count] * (1.0 + 1e-12)))
    threshold = rest[heavy] / (count - heavy)
    drawn = heavy + systematic(weights[heavy:], count - heavy, rng=rng)
    kept = np.concatenate([order[:heavy], order[drawn]])
    return kept, np.concatenate([log_weights[order[:heavy]], np.full(count - heavy, np.log(threshold))])


def heaviest(
    log_weights: Float64[np.ndarray, " n"], count: int, *, rng: np.random.Generator
) -> tuple[Int64[np.ndarray, " k"], Float64[np.ndarray, " k"]]:
    """The heaviest particles: a truncation, which is biased. See `optimal_resample` for arguments and results."""
    kept = np.argsort(-log_weights, kind="stable")[:count]
    return kept, log_weights[kept]


# To add one: a function, its name here and in `Resampling`.
RESAMPLING: Mapping[Resampling, Callable[..., tuple[np.ndarray, np.ndarray]]] = MappingProxyType(
    {"optimal": optimal_resample, "heaviest": heaviest}
)
"""Ways to choose k of n weighted particles, by name."""
