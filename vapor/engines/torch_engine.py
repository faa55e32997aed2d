"""The network run by torch: eager on processors, as a recorded graph of kernels on a GPU."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext

import numpy as np
import torch
from jaxtyping import Float32, UInt8
from torch import Tensor, nn

from filtering.errors import VaporTrackError
from vapor.checkpoints.checkpoint import Checkpoint
from vapor.engines.engine import Device, EngineName, Precision, Seen, resolve_device
from vapor.regressors.backbones import Describer
from vapor.threads import limit_torch

_Autocast = Callable[[], AbstractContextManager[object]]
_WARM_UP = 3  # runs before a graph is recorded, in which libraries choose their kernels


class TorchEngine:
    """A network that torch runs, eagerly on processors; bfloat16 is for the backbone, on GPUs only.

    Raises:
        VaporTrackError: a device or a precision that is not there.
    """

    name: EngineName = "torch"

    def __init__(self, checkpoint: Checkpoint, *, device: Device = "auto", precision: Precision = "float32") -> None:
        limit_torch()
        self._device = resolve_device(device)
        if precision != "float32" and self._device.type == "cpu":
            raise VaporTrackError(
                f"precision {precision}: torch is slow with it on processors, expected a GPU or engine openvino"
            )
        self._precision: Precision = precision
        whole = WholeNetwork(checkpoint).eval().to(self._device)
        # Channels-last convolutions take about two thirds of the time here.
        self._network = whole.to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
        self.noise_dim: int = whole.network.noise_dim
        self._recorded: dict[tuple[int, ...], Recorded] = {}

    @property
    def device(self) -> str:
        """cpu or cuda."""
        return str(self._device)

    @torch.inference_mode()
    def run(self, image: UInt8[np.ndarray, "h w 3"], noise: Float32[np.ndarray, "m d"]) -> Seen:
        """Run on an image, as `Engine.run`."""
        inputs = torch.from_numpy(np.ascontiguousarray(image)), torch.from_numpy(noise)
        outputs = self._on_gpu(*inputs) if self._device.type == "cuda" else self._network(*inputs)
        translation, rotation, *description = (output.float().cpu().numpy() for output in outputs)
        return Seen(translation, rotation, description[0] if description else np.zeros(0, np.float32))

    def _on_gpu(self, image: Tensor, noise: Tensor) -> tuple[Tensor, ...]:
        """Kernels of a small network take less time than starting them one by one: they are recorded, and replayed."""
        shape = tuple(noise.shape)
        if shape not in self._recorded:
            inputs = image.to(self._device), noise.to(self._device)
            self._recorded = {shape: Recorded(self._network, inputs, self._autocast)}
        return self._recorded[shape](image, noise)

    def _autocast(self) -> AbstractContextManager[object]:
        return torch.autocast("cuda", torch.bfloat16) if self._precision == "bfloat16" else nullcontext()


class Recorded:
    """A network's kernels for images and noise of one size, as a CUDA graph; each call overwrites the last outputs."""

    def __init__(
        self, network: Callable[..., tuple[Tensor, ...]], inputs: tuple[Tensor, Tensor], autocast: _Autocast
    ) -> None:
        self._inputs = inputs
        self._graph = torch.cuda.CUDAGraph()
        stream = torch.cuda.Stream()
        stream.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(stream), autocast():
            for _ in range(_WARM_UP):
                network(*inputs)
        torch.cuda.current_stream().wait_stream(stream)
        with torch.cuda.graph(self._graph), autocast():
            self._outputs = network(*inputs)

    def __call__(self, image: Tensor, noise: Tensor) -> tuple[Tensor, ...]:
        """The network's outputs for other inputs, from this device or another."""
        for own, given in zip(self._inputs, (image, noise), strict=True):
            own.copy_(given)
        self._graph.replay()
        return self._outputs


class WholeNetwork(nn.Module):
    """One image and noise in; positions, rotations and, for a model with an OOD model, a description out."""

    def __init__(self, checkpoint: Checkpoint) -> None:
        super().__init__()
        self.network = checkpoint.build_network()
        self.described = checkpoint.ood_model is not None
        self._describer = Describer(self.network) if self.described else None

    def forward(
        self, image: UInt8[Tensor, "h w 3"], noise: Float32[Tensor, "m d"]
    ) -> tuple[Float32[Tensor, "m 3"], Float32[Tensor, "m 3 3"]] | tuple[Tensor, Tensor, Float32[Tensor, " n"]]:
        """Posterior samples for given noise; networks without noise give one sample for each row."""
        images = image[None]
        translation, rotation = self.network(self.network.normalise(images), noise[None])
        if self._describer is None:
            return translation[0], rotation[0]
        return translation[0], rotation[0], self._describer.last(images)[0]


def traced_inputs(whole: WholeNetwork, *, samples: int = 20) -> tuple[UInt8[Tensor, "h w 3"], Float32[Tensor, "m d"]]:
    """An image and noise by which a network is traced; then it takes any number of rows of noise.

    The noise has one column at least, as formats of networks have no empty inputs.
    """
    config, generator = whole.network.config, torch.Generator().manual_seed(0)
    shape = (config.image_height, config.image_width, 3)
    image = torch.randint(0, 256, shape, dtype=torch.uint8, generator=generator)
    return image, torch.randn(samples, max(1, whole.network.noise_dim), generator=generator)
