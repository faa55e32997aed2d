"""BatchNorm of batches that several processes share: their statistics are those of the whole batch."""

from __future__ import annotations

from typing import Any

import torch
import torch.distributed as dist
from jaxtyping import Float
from torch import Tensor, nn


class SharedBatchNorm(nn.BatchNorm2d):
    """BatchNorm2d that takes mean and variance over the images of all processes, of which each has equally many.

    torch's SyncBatchNorm does the same on GPUs only.
    """

    def forward(self, input: Float[Tensor, "b c h w"]) -> Float[Tensor, "b c h w"]:
        """The normalised input, in its precision."""
        if not self.training:
            return super().forward(input)
        variance, mean = torch.var_mean(input.float(), dim=(0, 2, 3), unbiased=False)
        # float64, as the variance of means would otherwise be a difference of large numbers.
        parts = torch.stack([mean, variance, mean.double().square()]).double()
        mean, variance, square = _Sum.apply(parts).div(dist.get_world_size()).unbind()
        variance = variance + square - mean.square()
        self._remember(mean.detach(), variance.detach(), input.numel() // input.shape[1] * dist.get_world_size())
        scale = self.weight * torch.rsqrt(variance + self.eps).float()
        shift = self.bias - mean.float() * scale
        return torch.addcmul(shift[:, None, None], input.float(), scale[:, None, None]).to(input.dtype)

    @torch.no_grad()
    def _remember(self, mean: Tensor, variance: Tensor, count: int) -> None:
        """Move the running statistics as torch does: the variance without bias."""
        if self.running_mean is None or self.running_var is None or self.num_batches_tracked is None:
            return
        self.num_batches_tracked += 1
        momentum = self.momentum if self.momentum is not None else 1.0 / float(self.num_batches_tracked)
        self.running_mean.lerp_(mean.float(), momentum)
        self.running_var.lerp_((variance * count / (count - 1)).float(), momentum)


def share_batch_statistics(network: nn.Module) -> None:
    """Let every BatchNorm2d of a network take the statistics of all processes, in place; names and weights stay."""
    for name, child in network.named_children():
        if type(child) is nn.BatchNorm2d:
            shared = SharedBatchNorm(child.num_features, child.eps, child.momentum)
            shared.weight, shared.bias = child.weight, child.bias
            shared._buffers.update(child._buffers)
            shared.train(child.training)
            setattr(network, name, shared)
        else:
            share_batch_statistics(child)


class _Sum(torch.autograd.Function):
    """The sum over all processes; every one's loss depends on it, so its gradient is the sum of theirs."""

    @staticmethod
    def forward(ctx: Any, value: Tensor) -> Tensor:
        value = value.clone()
        dist.all_reduce(value)
        return value

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> Tensor:
        gradient = gradients[0].clone()
        dist.all_reduce(gradient)
        return gradient
