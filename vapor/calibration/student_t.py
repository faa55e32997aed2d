"""Student t densities of errors, with their slopes, and their sums over the places of each image."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor


def log_densities(
    residual: Tensor, covariance: Tensor, fraction: Tensor, spread: Tensor, floor: Tensor, tail: Tensor
) -> tuple[Tensor, Tensor]:
    """Log of fraction times Student t density of each residual, (p,), and its slopes (p, 8).

    The slopes are by the logarithms of spread, floor (6) and tail. Written out, they take half the time of automatic
    ones.

    Args:
        residual: The true pose from each of p places, (p, 6).
        covariance: Of the samples of each place, (p, 6, 6).
        fraction: Of an image's samples that each place has, (p,).
        spread: As of `ErrorModel`, ().
        floor: Likewise, (6,).
        tail: Likewise, ().
    """
    factor = torch.linalg.cholesky(spread * covariance + torch.diag(floor.square()))
    inverse = torch.cholesky_inverse(factor)
    solved = (inverse @ residual[..., None])[..., 0]
    squared = (residual * solved).sum(dim=1)
    half = (tail + 6.0) / 2.0
    log_volume = torch.diagonal(factor, dim1=1, dim2=2).log().sum(dim=1)
    log_constant = torch.lgamma(half) - torch.lgamma(tail / 2.0) - 3.0 * torch.log(tail * np.pi)
    log_far = torch.log1p(squared / tail)
    by_scale = solved[:, :, None] * solved[:, None, :] * (half / (tail + squared))[:, None, None] - 0.5 * inverse
    by_tail = 0.5 * (torch.digamma(half) - torch.digamma(tail / 2.0) - log_far) - 3.0 / tail
    by_tail += half * squared / (tail * (tail + squared))
    slopes = torch.cat(
        [
            spread * (by_scale * covariance).sum(dim=(1, 2))[:, None],
            2.0 * floor.square() * torch.diagonal(by_scale, dim1=1, dim2=2),
            tail * by_tail[:, None],
        ],
        dim=1,
    )
    return fraction.log() + log_constant - log_volume - half * log_far, slopes


def log_sums(terms: Tensor, image: Tensor) -> Tensor:
    """Log of the sum of exponentials over the places of each image, (n,).

    Args:
        terms: Logarithms, one for each place, (p,).
        image: Which of the n images each place is of, in increasing order, (p,).
    """
    count = int(image[-1]) + 1
    top = torch.full((count,), -torch.inf, dtype=terms.dtype).scatter_reduce(0, image, terms.detach(), "amax")
    return top + torch.zeros(count, dtype=terms.dtype).scatter_add(0, image, (terms - top[image]).exp()).log()
