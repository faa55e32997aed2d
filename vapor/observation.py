"""VaporObservationModel: image -> PosePosterior; in use the only place where numpy and torch meet."""

from __future__ import annotations

from copy import copy
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from filtering.error_model import FOREIGN
from filtering.errors import VaporTrackError
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from sequences.frame import Camera
from vapor.cameras import AsTakenBy
from vapor.checkpoints.checkpoint import Checkpoint
from vapor.checkpoints.file_format import load_checkpoint
from vapor.checkpoints.shipped_models import find_model
from vapor.images import prepare, require_rgb
from vapor.regressors.familiarity import Describer

Device = Literal["auto", "cpu", "cuda"]


class VaporObservationModel:
    """A pose regressor as an observation model: one encoder pass and `num_samples` poses an image.

    The filter takes the places among the samples, with the errors that the model's calibration found.

    All arithmetic is float32; the poses that leave are float64. The latent noise comes from the caller's generator, so
    the same image, generator state, machine and number of threads give the same bits.

    Args:
        checkpoint: A trained model.
        num_samples: Posterior samples per image.
        device: Where the network runs.
        camera: The camera of the images, undistorted, such as `SequenceReader.camera`; None where unknown. Where its
            view differs from that of the camera that the model learned with, images are resampled.
    """

    def __init__(
        self,
        checkpoint: Checkpoint,
        *,
        num_samples: int = 1000,
        device: Device = "auto",
        camera: Camera | None = None,
    ) -> None:
        if num_samples < 1:
            raise VaporTrackError(f"num_samples is {num_samples}, expected at least 1")
        self.checkpoint = checkpoint
        self.num_samples = num_samples
        self.camera = camera
        self.device = resolve_device(device)
        self._as_learned = AsTakenBy(checkpoint.camera, checkpoint.network.frame_size)
        network = checkpoint.build_network().to(self.device)
        # Channels-last convolutions take about two thirds of the time here.
        self._network = network.to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
        self._describer = Describer(self._network) if checkpoint.familiarity else None

    @staticmethod
    def from_checkpoint(
        model: str | Checkpoint, *, num_samples: int = 1000, device: Device = "auto", camera: Camera | None = None
    ) -> VaporObservationModel:
        """The model of a file, of a name that ships with the package, or of a loaded checkpoint.

        Raises:
            CheckpointError: no such model, or an unusable file.
        """
        checkpoint = model if isinstance(model, Checkpoint) else load_checkpoint(find_model(model))
        return VaporObservationModel(checkpoint, num_samples=num_samples, device=device, camera=camera)

    def seen_by(self, camera: Camera | None) -> VaporObservationModel:
        """The same model with the same network, for images of a camera; its notices begin anew."""
        other = copy(self)
        other.camera, other._as_learned = camera, AsTakenBy(self.checkpoint.camera, self.checkpoint.network.frame_size)
        return other

    @property
    def notices(self) -> list[str]:
        """What a person should know of the model's file, and of the camera from the images observed so far."""
        return [*self.checkpoint.notices, *self._as_learned.notices]

    def observe(self, image: np.ndarray, *, rng: np.random.Generator) -> PosePosterior:
        """The posterior of one image, and how unlike the training images it is, from one pass of the network.

        Args:
            image: (H, W, 3) uint8 RGB of any size.
            rng: Source of the latent noise ε.

        Raises:
            VaporTrackError: the image is not (H, W, 3) uint8.
        """
        config = self.checkpoint.network
        require_rgb(image)
        prepared = np.ascontiguousarray(prepare(self._as_learned(image, self.camera), config)[None])
        noise = rng.standard_normal((1, self.num_samples, self._network.noise_dim), dtype=np.float32)
        with torch.inference_mode():
            seen = torch.from_numpy(prepared).to(self.device)
            pixels = self._network.normalise(seen)
            noise = torch.from_numpy(noise).to(self.device)
            samples = _to_poses(*self._network(pixels, noise))
            unfamiliarity = self._unfamiliarity(seen)
        return PosePosterior.from_samples(samples, self.checkpoint.calibration.errors, unfamiliarity=unfamiliarity)

    def _unfamiliarity(self, seen: UInt8[Tensor, "1 h w 3"]) -> float:
        """Score of the image that went through the network last; 0 where the model does not say what is familiar."""
        if self._describer is None or self.checkpoint.familiarity is None:
            return 0.0
        score = float(self.checkpoint.familiarity.unfamiliarity(self._describer.last(seen))[0])
        return min(score, FOREIGN) if self._as_learned.sees_less else score


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
