"""One training by several processes (torchrun): each learns from its part of every batch, and gradients are averaged.

All of them read the data, draw the same random numbers for whole batches, and hold the same weights after every step.
The first one evaluates, writes and reports.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta
from typing import Any, TypeVar

import numpy as np
import torch
import torch.distributed as dist
from jaxtyping import Int64
from torch import Tensor, nn
from torch.nn.parallel import DistributedDataParallel

from vapor.engines.engine import Device, resolve_device
from vapor.regressors.base import PoseRegressor
from vapor.training_data.training_set import TrainingError

Value = TypeVar("Value")

_LAUNCHED = ("RANK", "WORLD_SIZE", "MASTER_ADDR", "MASTER_PORT")  # variables that torchrun sets
_JOINING = timedelta(minutes=5)  # of waiting for the others to start
_PATIENCE = timedelta(hours=12)  # the others wait while the first process calibrates


def num_processes() -> int:
    """Number of processes that share the training: 1 where none were joined."""
    return dist.get_world_size() if dist.is_available() and dist.is_initialized() else 1


def is_first() -> bool:
    """Whether this is the process that evaluates, writes and reports."""
    return num_processes() == 1 or dist.get_rank() == 0


@contextmanager
def joined_processes(device: Device) -> Iterator[None]:
    """Join the processes that a launcher such as torchrun started, inside a `with` block; each takes a GPU of its own.

    Raises:
        TrainingError: the processes cannot be joined, a GPU is missing, or another process ended.
    """
    if os.environ.get("WORLD_SIZE", "1") == "1" or not all(name in os.environ for name in _LAUNCHED):
        yield
        return
    process = f"process {os.environ['RANK']} of {os.environ['WORLD_SIZE']}, counted from 0"
    on_gpu = resolve_device(device).type == "cuda"
    from torch.distributed.rendezvous import rendezvous  # which a torch without torch.distributed lacks

    try:
        if on_gpu:
            torch.cuda.set_device(int(os.environ.get("LOCAL_RANK", "0")))
        store, rank, count = next(rendezvous("env://", timeout=_JOINING))
        backend = "nccl" if on_gpu else "gloo"
        dist.init_process_group(backend, store=store, rank=rank, world_size=count, timeout=_PATIENCE)
    except (RuntimeError, ValueError) as error:
        raise TrainingError(
            f"{process}: cannot join the others ({_line(error)}), expected no more processes than GPUs, or --device cpu"
        ) from error
    try:
        yield
    except RuntimeError as error:
        if isinstance(error, dist.DistError) or "gloo" in str(error):
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
        return getattr(self.network, loss)(*batch)


def make_learner(network: PoseRegressor) -> nn.Module:
    """A module that gives the loss of this process' part of a batch; its gradients are averages of all parts.

    On GPUs, BatchNorm takes the statistics of whole batches from now on; on processors, the statistics of each part.
    """
    learner = Learner(network)
    if num_processes() == 1:
        return learner
    if network.pixel_mean.is_cuda:  # torch has it for GPUs only; parameters and their names stay
        nn.SyncBatchNorm.convert_sync_batchnorm(network)
    # Some heads have weights that never learn, as the unused spread of a latent.
    return DistributedDataParallel(learner, static_graph=True)


def mean_of_all(value: Tensor) -> Tensor:
    """The mean of a number over all processes."""
    return sum_of_all(value.clone()) / num_processes()


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


def _line(error: BaseException) -> str:
    return (str(error).strip() or type(error).__name__).splitlines()[0]
