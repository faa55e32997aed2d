"""Functions of which compilers of networks know only the parts: while a network is traced, they are made of these."""

from __future__ import annotations

import math

import torch
from torch import Tensor


def normal_cdf(x: Tensor) -> Tensor:
    """Φ(x), the fraction of standard normal numbers below x."""
    if torch.jit.is_tracing():
        return 0.5 * (1.0 + torch.erf(x / math.sqrt(2.0)))  # 6e-8 off at most
    return torch.special.ndtr(x)


def count_below(numbers: Tensor, x: Tensor, *, or_equal: bool = False) -> Tensor:
    """How many of some ascending numbers are below each x (or equal to it), along the last axis."""
    if torch.jit.is_tracing():
        below = numbers[..., None, :] <= x[..., None] if or_equal else numbers[..., None, :] < x[..., None]
        return below.sum(dim=-1)
    return torch.searchsorted(numbers.contiguous(), x.contiguous(), right=or_equal)
