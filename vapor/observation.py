"""VaporObservationModel: image -> PosteriorSamples; the only border between numpy and torch in use."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float, Float64
from torch import Tensor

from filtering.errors import VaporTrackError
from filtering.posterior import LikelihoodModel, PosteriorSamples
from filtering.se3 import Poses
from vapor.checkpoint import Checkpoint, find_model, load_checkpoint
from vapor.images import prepare
from vapor.network import DensityRegressor

Device = Literal["auto", "cpu", "cuda"]


class VaporObservationModel:
    """A pose regressor as an observation model: one encoder pass and `num_samples` poses an image.

    Of a regressor whose posterior is a density (`DensityRegressor`) the filter draws from that and evaluates it; the
    samples of others become kernels.

    All arithmetic is float32; the poses that leave are float64. The latent noise comes from the caller's generator, so
    the same image, generator state, machine and number of threads give the same bits.

    Args:
        checkpoint: A trained model.
        num_samples: Posterior samples per image.
        device: Where the network runs.
    """

    def __init__(self, checkpoint: Checkpoint, *, num_samples: int = 1000, device: Device = "auto") -> None:
        if num_samples < 1:
            raise VaporTrackError(f"num_samples is {num_samples}, expected at least 1")
        self.checkpoint = checkpoint
        self.num_samples = num_samples
        self.device = resolve_device(device)
        network = checkpoint.build_network().to(self.device)
        # Channels-last convolutions take about two thirds of the time here.
        self._network = network.to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
        self._likelihood: LikelihoodModel = checkpoint.calibration.likelihood(checkpoint.prior_poses)

    @staticmethod
    def from_checkpoint(
        model: str | Checkpoint, *, num_samples: int = 1000, device: Device = "auto"
    ) -> VaporObservationModel:
        """The model of a file, of a name that ships with the package, or of a loaded checkpoint.

        Raises:
            CheckpointError: no such model, or an unusable file.
        """
        checkpoint = model if isinstance(model, Checkpoint) else load_checkpoint(find_model(model))
        return VaporObservationModel(checkpoint, num_samples=num_samples, device=device)

    def observe(self, image: np.ndarray, *, rng: np.random.Generator) -> PosteriorSamples:
        """The posterior of one image.

        Args:
            image: (H, W, 3) uint8 RGB of any size.
            rng: Source of the latent noise ε.

        Raises:
            VaporTrackError: the image is not (H, W, 3) uint8.
        """
        config = self.checkpoint.network
        prepared = np.ascontiguousarray(prepare(image, config)[None])
        noise = rng.standard_normal((1, self.num_samples, self._network.noise_dim), dtype=np.float32)
        density = None
        with torch.inference_mode():
            pixels = self._network.normalise(torch.from_numpy(prepared).to(self.device))
            noise = torch.from_numpy(noise).to(self.device)
            if isinstance(self._network, DensityRegressor):
                feature = self._network.describe(pixels)
                samples = _to_poses(*self._network.sample(feature, noise))
                density = NetworkDensity(samples, self._network, feature)
            else:
                samples = _to_poses(*self._network(pixels, noise))
        return self.checkpoint.calibration.posterior(samples, self._likelihood, density)


@dataclass(frozen=True)
class NetworkDensity:
    """The density of a network's posterior samples, evaluated by the network itself; fulfils `PoseDensity`.

    Attributes:
        centres: Samples, world_from_camera, (m,).
        network: Evaluated in float32, without gradients.
        feature: Of the image.
    """

    centres: Poses
    network: DensityRegressor
    feature: Float[Tensor, "1 f"]

    def sample(self, num_samples: int, *, rng: np.random.Generator) -> Poses:
        """Draw poses (num_samples,), other ones than the centres."""
        noise = rng.standard_normal((1, num_samples, self.network.noise_dim), dtype=np.float32)
        with torch.inference_mode():
            return _to_poses(*self.network.sample(self.feature, torch.from_numpy(noise).to(self.feature.device)))

    def log_density(self, poses: Poses, *, near_only: bool = False) -> Float64[np.ndarray, " n"]:
        """Log density of poses (n,), per m³ rad³, −∞ where it is 0; `near_only` makes no difference."""
        with torch.inference_mode():
            translation, rotation = (
                torch.from_numpy(np.array(part[None])).to(self.feature) for part in (poses.translation, poses.rotation)
            )
            return self.network.log_density(self.feature, translation, rotation)[0].cpu().double().numpy()


def _to_poses(translation: Float[Tensor, "1 m 3"], rotation: Float[Tensor, "1 m 3 3"]) -> Poses:
    return Poses(rotation[0].cpu().double().numpy(), translation[0].cpu().double().numpy())


def resolve_device(device: Device) -> torch.device:
    """The torch device of an option; "auto" is CUDA where there is one.

    Raises:
        VaporTrackError: CUDA asked for and absent.
    """
    if device == "cuda" and not torch.cuda.is_available():
        raise VaporTrackError("device cuda: this torch finds no CUDA device, expected --device cpu or auto")
    return torch.device("cuda" if device != "cpu" and torch.cuda.is_available() else "cpu")
