"""The exponential moving average of a network's weights."""

from __future__ import annotations

import torch
from torch import nn
from torch.optim.swa_utils import get_ema_multi_avg_fn


@torch.no_grad()
def update_average(average: nn.Module, network: nn.Module, decay: float, step: int) -> None:
    """Move the average towards the weights and BatchNorm statistics; faster in the first steps, which know little.

    Args:
        average: Changed in place.
        network: Of the same shape.
        decay: What is left of the average after a step; 0 leaves the average as it is.
        step: Counted from 0 over the whole training.
    """
    if not decay:
        return
    pairs = list(zip(average.state_dict().values(), network.state_dict().values(), strict=True))
    numbers = [pair for pair in pairs if pair[0].is_floating_point()]
    move = get_ema_multi_avg_fn(min(decay, (1 + step) / (10 + step)))
    move([mine for mine, _ in numbers], [its for _, its in numbers], 0)
    for mine, its in pairs:
        if not mine.is_floating_point():
            mine.copy_(its)
