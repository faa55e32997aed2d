"""Time of a network by itself: batches, precisions, kernels started one by one or replayed as a CUDA graph."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from vapor.benchmark.gpu.deviation import sample_deviation
from vapor.benchmark.gpu.parity import TF32
from vapor.benchmark.gpu.setting import Setting
from vapor.benchmark.gpu.stages import Deadline, Finding
from vapor.benchmark.gpu.timing import timed
from vapor.checkpoints.checkpoint import Checkpoint
from vapor.engines.torch_engine import Recorded

_Samples = Callable[[Tensor, Tensor], tuple[Tensor, ...]]


def time_networks(setting: Setting, deadline: Deadline) -> Iterator[Finding]:
    """Times of batches that are on the device, and how far bfloat16 and recorded kernels deviate from eager float32."""
    for batch in setting.sizes.batches:
        for name, checkpoint in setting.networks.items():
            yield from _time_batch(f"{name}, {batch} a batch", checkpoint, batch, setting, deadline)


def _time_batch(
    what: str, checkpoint: Checkpoint, batch: int, setting: Setting, deadline: Deadline
) -> Iterator[Finding]:
    device, config = setting.torch_device, checkpoint.network
    network = checkpoint.build_network().eval().to(device)
    network = network.to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
    generator = torch.Generator().manual_seed(0)
    shape = (batch, config.image_height, config.image_width, 3)
    images = torch.randint(0, 256, shape, dtype=torch.uint8, generator=generator).to(device)
    noise = torch.randn((batch, setting.sizes.samples, network.noise_dim), generator=generator).to(device)

    def samples(images: Tensor, noise: Tensor) -> tuple[Tensor, ...]:
        return network(network.normalise(images), noise)

    def time(call: str, run: _Samples) -> Finding:
        found = timed(call, lambda: run(images, noise), device, deadline, repetitions=setting.sizes.repetitions)
        return replace(found, note=f"{1e3 * batch / found.value:.0f} images/s, {found.note}")

    exact = None
    for precision in ("float32", "bfloat16"):
        bfloat16 = precision == "bfloat16"

        def autocast(enabled: bool = bfloat16) -> AbstractContextManager[object]:
            return torch.autocast(device.type, torch.bfloat16, enabled=enabled)

        def eager(
            images: Tensor, noise: Tensor, autocast: Callable[[], AbstractContextManager[object]] = autocast
        ) -> tuple[Tensor, ...]:
            with torch.inference_mode(), autocast():
                return samples(images, noise)

        found = _on_cpu(eager(images, noise))
        if exact is None:
            exact = found
        else:
            yield from sample_deviation(f"{what}, {precision} from float32", found, exact)
        yield time(f"{what}, {precision}, eager", eager)
        if setting.device == "cuda":
            # Recorded for other images, so that a replay that ignored the given ones would be noticed.
            with torch.inference_mode():
                recorded = Recorded(samples, (torch.zeros_like(images), torch.zeros_like(noise)), autocast)

            def replayed(images: Tensor, noise: Tensor, recorded: Recorded = recorded) -> tuple[Tensor, ...]:
                with torch.inference_mode():
                    return recorded(images, noise)

            again = _on_cpu(replayed(images, noise))
            if not bfloat16:
                yield from sample_deviation(f"{what}, {precision}, graph from eager", again, found, TF32)
            yield time(f"{what}, {precision}, graph", replayed)


def _on_cpu(poses: tuple[Tensor, ...]) -> tuple[np.ndarray, np.ndarray]:
    translation, rotation = (part.float().cpu().numpy() for part in poses)
    return translation, rotation
