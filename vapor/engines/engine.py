"""Engine: runs a network on one image; and the settings and device by which one is chosen."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float32, UInt8

from filtering.errors import VaporTrackError

if TYPE_CHECKING:
    import torch

EngineName = Literal["auto", "torch", "openvino"]
Precision = Literal["float32", "bfloat16"]
Device = Literal["auto", "cpu", "cuda"]


@dataclass(frozen=True)
class EngineConfig:
    """What runs the network, and how precisely."""

    engine: EngineName = "auto"
    """What runs the network: PyTorch, or OpenVINO on CPUs (extra `openvino`), which compiles a network once and keeps
    it in the user's cache. auto: on a CPU the one that was faster when the network was compiled, else torch."""
    precision: Precision = "float32"
    """Arithmetic of the network. bfloat16 is faster on GPUs, and with openvino on CPUs that have it; it moves samples
    by centimetres."""

    @property
    def network(self) -> EngineConfig:
        """These two settings alone, without the settings of a subclass."""
        return EngineConfig(self.engine, self.precision)


@dataclass(frozen=True)
class Seen:
    """Result of a network for one image.

    Attributes:
        translation: Positions of its posterior samples, metres, world_from_camera.
        rotation: Their rotation matrices.
        description: Input of `OodModel`; empty where the model has none.
    """

    translation: Float32[np.ndarray, "m 3"]
    rotation: Float32[np.ndarray, "m 3 3"]
    description: Float32[np.ndarray, " d"]


@runtime_checkable
class Engine(Protocol):
    """A network ready to be run; by one thread at a time, not always the same."""

    @property
    def name(self) -> EngineName:
        """Name of the engine."""
        ...

    @property
    def device(self) -> str:
        """Device of the engine: cpu or cuda."""
        ...

    @property
    def noise_dim(self) -> int:
        """Number of normal numbers for one posterior sample."""
        ...

    def run(self, image: UInt8[np.ndarray, "h w 3"], noise: Float32[np.ndarray, "m d"]) -> Seen:
        """Run on an RGB image of the network's size (`vapor.images.prepare`), with standard normal noise."""
        ...


def resolve_device(device: Device) -> torch.device:
    """The torch device of an option; "auto" is CUDA where there is one.

    Raises:
        VaporTrackError: CUDA asked for and absent.
    """
    import torch

    if device == "cuda" and not torch.cuda.is_available():
        raise VaporTrackError("device cuda: this torch finds no CUDA device, expected --device cpu or auto")
    return torch.device("cuda" if device != "cpu" and torch.cuda.is_available() else "cpu")
