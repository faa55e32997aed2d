"""VaporObservationModel: image -> PosteriorSamples; the only border between numpy and torch in use."""

from __future__ import annotations

from typing import Literal

import numpy as np
import torch
from jaxtyping import Float32

from filtering.errors import VaporTrackError
from filtering.posterior import LikelihoodModel, PosteriorSamples
from filtering.se3 import Poses
from vapor.checkpoint import Checkpoint, find_model, load_checkpoint
from vapor.images import prepare

Device = Literal["auto", "cpu", "cuda"]


class VaporObservationModel:
    """The variational pose regressor as an observation model: one encoder pass and `num_samples` poses an image.

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
        prepared = prepare(image, config)
        noise = rng.standard_normal((self.num_samples, self._network.noise_dim), dtype=np.float32)
        poses = self._infer(prepared[None], noise[None])
        return self.checkpoint.calibration.posterior(poses, self._likelihood)

    def _infer(self, images: np.ndarray, noise: Float32[np.ndarray, "1 m d"]) -> Poses:
        """Posterior samples (m,) of one prepared image (1, h, w, 3)."""
        with torch.inference_mode():
            pixels = torch.from_numpy(np.ascontiguousarray(images)).to(self.device)
            translation, rotation = self._network(
                self._network.normalise(pixels), torch.from_numpy(noise).to(self.device)
            )
        return Poses(rotation[0].cpu().double().numpy(), translation[0].cpu().double().numpy())


def resolve_device(device: Device) -> torch.device:
    """The torch device of an option; "auto" is CUDA where there is one.

    Raises:
        VaporTrackError: CUDA asked for and absent.
    """
    if device == "cuda" and not torch.cuda.is_available():
        raise VaporTrackError("device cuda: this torch finds no CUDA device, expected --device cpu or auto")
    return torch.device("cuda" if device != "cpu" and torch.cuda.is_available() else "cpu")
