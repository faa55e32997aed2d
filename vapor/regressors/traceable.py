"""Functions of which compilers of networks know only the parts: while a network is traced, they are made of these."""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn import functional


def normal_cdf(x: Tensor) -> Tensor:
    """Φ(x), the fraction of standard normal numbers below x."""
    if _is_tracing():
        return 0.5 * (1.0 + torch.erf(x / math.sqrt(2.0)))  # 6e-8 off at most
    return torch.special.ndtr(x)


def count_below(numbers: Tensor, x: Tensor, *, or_equal: bool = False) -> Tensor:
    """How many of some ascending numbers are below each x (or equal to it), along the last axis."""
    if _is_tracing():
        below = numbers[..., None, :] <= x[..., None] if or_equal else numbers[..., None, :] < x[..., None]
        return below.sum(dim=-1)
    return torch.searchsorted(numbers.contiguous(), x.contiguous(), right=or_equal)


def mean_of_cells(maps: Tensor, grid: tuple[int, int]) -> Tensor:
    """Means of images (b, c, h, w) in the cells of a grid, (b, c, rows, columns); cells may share a row or column."""
    if not _is_tracing():
        return functional.adaptive_avg_pool2d(maps, grid)
    rows, columns = (_cells(int(size), count) for size, count in zip(maps.shape[2:], grid, strict=True))
    return rows @ maps @ columns.T


def _cells(size: int, count: int) -> Tensor:
    """Weights (count, size) of which each row is the mean of one cell."""
    weights = torch.zeros(count, size)
    for cell in range(count):
        first, end = cell * size // count, -((cell + 1) * -size // count)
        weights[cell, first:end] = 1.0 / (end - first)
    return weights


def _is_tracing() -> bool:
    return torch.jit.is_tracing()  # pyright: ignore[reportPrivateImportUsage]
