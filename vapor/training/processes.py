"""One training by several processes (torchrun): each learns from its part of every batch, and gradients are averaged.

All of them read the data, draw the same random numbers for whole batches, and hold the same weights after every step:
a batch gives the loss that it gives one process, up to rounding. The first one evaluates, writes and reports.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import timedelta
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import torch
import torch.distributed as dist
from jaxtyping import Float, Int64
from torch import Tensor, nn
from torch.nn.parallel import DistributedDataParallel

from vapor.engines.engine import Device, resolve_device
from vapor.regressors.base import PoseRegressor
from vapor.training_data.training_set import TrainingError

if TYPE_CHECKING:
    from torch.distributed.distributed_c10d import Store

Value = TypeVar("Value")

_LAUNCHED = ("RANK", "WORLD_SIZE", "MASTER_ADDR", "MASTER_PORT")  # variables that torchrun sets
_JOINING = timedelta(minutes=5)  # of waiting for the others to start
_PATIENCE = timedelta(hours=12)  # the others wait while the first one calibrates


def num_processes() -> int:
    """How many processes share the training: 1 where none were joined."""
    return dist.get_world_size() if dist.is_available() and dist.is_initialized() else 1


def is_first() -> bool:
    """Whether this is the process that evaluates, writes and reports."""
    return num_processes() == 1 or dist.get_rank() == 0


@contextmanager
def joined_processes(device: Device) -> Iterator[None]:
    """Join the processes that torchrun started, if it did, inside a `with` block; each takes a GPU of its own.

    Raises:
        TrainingError: they cannot be joined, or another process ended.
        SystemExit: another process has reported its error already.
    """
    if _whole("WORLD_SIZE", 1) == 1 or not all(name in os.environ for name in _LAUNCHED):
        yield
        return
    process = f"process {_whole('RANK', 0)} of {_whole('WORLD_SIZE', 1)}"
    backend = _backend(device)
    from torch.distributed.rendezvous import rendezvous  # which a torch without torch.distributed lacks

    try:
        store, rank, count = next(rendezvous("env://", timeout=_JOINING))
        dist.init_process_group(backend, store=store, rank=rank, world_size=count, timeout=_PATIENCE)
    except (RuntimeError, ValueError) as error:
        where = f"{os.environ['MASTER_ADDR']}:{os.environ['MASTER_PORT']}"
        raise TrainingError(f"{process}: cannot join the others at {where}: {_line(error)}") from error
    try:
        yield
    except BaseException as error:
        if not _first_to_fail(store):
            raise SystemExit(1) from error
        if isinstance(error, dist.DistError) or (isinstance(error, RuntimeError) and "gloo" in str(error)):
            raise TrainingError(f"{process}: another one ended, or cannot be reached: {_line(error)}") from error
        raise
    finally:
        dist.destroy_process_group()


def own_part(count: int, *, pairs: bool = False) -> Int64[np.ndarray, " k"]:
    """Images of a batch that this process learns from; `pairs` keeps the two halves of the batch together."""
    rows = np.arange(count)
    shared = rows.reshape(2, -1) if pairs else rows[None]
    rank = 0 if is_first() else dist.get_rank()
    return np.array_split(shared, num_processes(), axis=1)[rank].reshape(-1)


def require_shares(batch: int, *, pairs: bool) -> None:
    """Refuse a batch that cannot be divided evenly among the processes.

    Raises:
        TrainingError: with the sizes of both.
    """
    count, units = num_processes(), batch // 2 if pairs else batch
    if units % count:
        of = "pairs of images" if pairs else "images"
        raise TrainingError(
            f"batches of {units} {of} cannot be shared by {count} processes, expected a multiple of {count}"
            " (batch_size, or all images where these are fewer)"
        )


class Learner(nn.Module):
    """A network whose `forward` is its loss, as DistributedDataParallel requires."""

    def __init__(self, network: PoseRegressor) -> None:
        super().__init__()
        self.network = network

    def forward(self, loss: str, *batch: Any) -> Tensor:
        """The loss of a batch by the network's method of that name."""
        return getattr(self.network, loss)(*batch).total


def make_learner(network: PoseRegressor) -> nn.Module:
    """A module that gives the loss of this process' part of a batch; its gradients are averages of all parts.

    With several processes BatchNorm takes the statistics of whole batches from now on.
    """
    learner = Learner(network)
    if num_processes() == 1:
        return learner
    share_batch_statistics(network)
    # Some heads have weights that never learn, as the spread of a latent of which only the mean is taken.
    return DistributedDataParallel(learner, static_graph=True)


def mean_of_all(value: Tensor) -> Tensor:
    """The mean of a number over all processes."""
    if num_processes() > 1:
        value = value.clone()
        dist.all_reduce(value)
        value /= num_processes()
    return value


def sum_of_all(value: Tensor) -> Tensor:
    """The sum of a tensor over all processes, in place; each has its part, with zeros elsewhere."""
    if num_processes() > 1:
        dist.all_reduce(value)
    return value


def from_first(value: Value) -> Value:
    """The value of the first process, in all of them."""
    if num_processes() == 1:
        return value
    values = [value]
    dist.broadcast_object_list(values)
    return values[0]


def _backend(device: Device) -> str:
    """NCCL for GPUs, of which this process takes its own, or gloo."""
    if not dist.is_available():
        raise TrainingError("this torch is built without torch.distributed, expected one that has it, or one process")
    on_gpu = resolve_device(device).type == "cuda"
    backend = "nccl" if on_gpu else "gloo"
    if not dist.is_backend_available(backend):
        raise TrainingError(f"this torch is built without {backend}, expected it for several processes")
    if on_gpu:
        local, gpus = _whole("LOCAL_RANK", 0), torch.cuda.device_count()
        if local >= gpus:
            raise TrainingError(
                f"process {local + 1} of this machine has no GPU of its own: {gpus} found; start {gpus} processes, or"
                " train on --device cpu"
            )
        torch.cuda.set_device(local)
    return backend


def _first_to_fail(store: Store) -> bool:
    """Whether no other process has failed before, so that one error is reported once."""
    with suppress(RuntimeError):  # the store went with the process that kept it
        return store.add("failed", 1) == 1
    return False


def _whole(name: str, default: int) -> int:
    text = os.environ.get(name, str(default))
    if not text.isdecimal():
        raise TrainingError(f"{name} is {text!r} in the environment, expected a whole number as torchrun sets it")
    return int(text)


def _line(error: BaseException) -> str:
    return (str(error).strip() or type(error).__name__).splitlines()[0]


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
