"""The same images and noise on a device and on a processor: the same posterior samples, the same densities."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float64, UInt8
from torch import nn

from filtering.se3 import Poses
from vapor.benchmark.gpu.deviation import Tolerance, sample_deviation
from vapor.benchmark.gpu.setting import MODEL, Setting
from vapor.benchmark.gpu.stages import Deadline, Finding
from vapor.benchmark.step_times import blurred_noise
from vapor.benchmark.untrained import untrained
from vapor.checkpoints.checkpoint import Checkpoint
from vapor.engines.engine import Precision, Seen
from vapor.engines.torch_engine import TorchEngine
from vapor.images import prepare
from vapor.regressors.base import DensityRegressor
from vapor.regressors.network_config import NetworkConfig

FLOAT32 = Tolerance(metres=2e-4, degrees=0.01, nats=0.01)
"""Of sums in another order."""
TF32 = Tolerance(metres=2e-3, degrees=0.05, nats=0.1)
"""Of convolutions whose factors have ten bits (TensorFloat-32), torch's default on GPUs: at least ten times what such
rounding, simulated on a processor, made of the networks (0.06 mm, 0.002° and 0.008 nats)."""
_AT = 20  # samples of an image at which densities are compared


@dataclass(frozen=True)
class _Way:
    """A way to run a network on the device, and how far it may deviate from a processor's float32."""

    name: str
    tolerance: Tolerance | None
    precision: Precision = "float32"
    tf32: bool = True


_ON_PROCESSORS = (_Way("float32", FLOAT32),)
_ON_GPUS = (
    _Way("float32 without TF32", FLOAT32, tf32=False),
    _Way("float32 as it ships", TF32),
    _Way("bfloat16", None, "bfloat16"),
)


def compare_networks(setting: Setting, deadline: Deadline) -> Iterator[Finding]:
    """Deviations of a device from the processor: of posterior samples, of their kernel density, of exact densities."""
    walk = [frame.image for frame in setting.frames(deadline, setting.sizes.compared)]
    rng = np.random.default_rng(0)
    for name, checkpoint in setting.networks.items():
        of_place = name.startswith(MODEL)
        views = walk if of_place else [blurred_noise(rng) for _ in range(setting.sizes.compared)]
        images = [prepare(view, checkpoint.network) for view in views]
        yield from _compare_samples(name, checkpoint, images, setting, deadline, rng)
    for head in ("mixture", "flow", "retrieval"):
        deadline.check()
        yield _compare_densities(head, replace(setting.sizes.paper, head=head), setting, rng)


@contextmanager
def convolutions(*, tf32: bool) -> Iterator[None]:
    """Whether convolutions of a GPU may round their factors to ten bits, inside a `with` block."""
    before = torch.backends.cudnn.allow_tf32
    torch.backends.cudnn.allow_tf32 = tf32
    try:
        yield
    finally:
        torch.backends.cudnn.allow_tf32 = before


def _compare_samples(
    name: str,
    checkpoint: Checkpoint,
    images: Sequence[UInt8[np.ndarray, "h w 3"]],
    setting: Setting,
    deadline: Deadline,
    rng: np.random.Generator,
) -> Iterator[Finding]:
    reference = TorchEngine(checkpoint, device="cpu")
    noise = rng.standard_normal((len(images), setting.sizes.samples, reference.noise_dim), dtype=np.float32)

    def run(engine: TorchEngine) -> list[Seen]:
        seen = []
        for image, own in zip(images, noise, strict=True):
            deadline.check()
            seen.append(engine.run(image, own))
        return seen

    def stacked(seen: Sequence[Seen]) -> tuple[np.ndarray, np.ndarray]:
        return np.stack([each.translation for each in seen]), np.stack([each.rotation for each in seen])

    def densities(seen: Sequence[Seen]) -> Float64[np.ndarray, "n k"]:
        return np.stack(
            [
                checkpoint.calibration.density(_poses(each)).log_density(_poses(at)[np.arange(_AT)])
                for each, at in zip(seen, expected, strict=True)
            ]
        )

    expected = run(reference)
    truth, likely = stacked(expected), densities(expected)
    for way in _ON_GPUS if setting.device == "cuda" else _ON_PROCESSORS:
        with convolutions(tf32=way.tf32):
            found = run(TorchEngine(checkpoint, device=setting.device, precision=way.precision))
        what = f"{name}, {way.name}"
        yield from sample_deviation(what, stacked(found), truth, way.tolerance)
        apart = float(np.abs(densities(found) - likely).max())
        yield Finding(f"{what}: log density", apart, "nats", most=way.tolerance and way.tolerance.nats, note="greatest")


def _poses(seen: Seen) -> Poses:
    return Poses(seen.rotation.astype(np.float64), seen.translation.astype(np.float64))


def _compare_densities(head: str, config: NetworkConfig, setting: Setting, rng: np.random.Generator) -> Finding:
    """Deviation of a regressor's own density at its samples, without TF32; the weights are random."""
    network = untrained(config)
    images = torch.from_numpy(np.stack([prepare(blurred_noise(rng), config) for _ in range(2)]))
    on_cpu = network.build_network().eval()
    generator = torch.Generator().manual_seed(0)
    noise = torch.randn((len(images), _AT, on_cpu.noise_dim), generator=generator)
    with torch.inference_mode(), convolutions(tf32=False):
        poses = on_cpu(on_cpu.normalise(images), noise)
        expected = _log_density(on_cpu, images, *poses)
        on_device = network.build_network().eval().to(setting.torch_device)
        found = _log_density(on_device, *(part.to(setting.torch_device) for part in (images, *poses)))
    apart = float((found.cpu() - expected).abs().max())
    return Finding(f"{head}: exact log density", apart, "nats", most=FLOAT32.nats, note="greatest, without TF32")


def _log_density(
    network: nn.Module, images: torch.Tensor, translation: torch.Tensor, rotation: torch.Tensor
) -> torch.Tensor:
    assert isinstance(network, DensityRegressor)
    return network.log_density(network.extract_features(network.normalise(images)), translation, rotation)
