"""VaporObservationModel: image -> PosePosterior, by a network that an engine runs."""

from __future__ import annotations

from copy import copy
from functools import cached_property

import numpy as np

from filtering.errors import VaporTrackError
from filtering.measurement_noise import OUT_OF_DISTRIBUTION
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from filtering.storeys import Storeys
from sequences.frame import Camera
from vapor.cameras import AsTakenBy, ood_allowance
from vapor.checkpoints.checkpoint import Checkpoint, ModelDescription
from vapor.checkpoints.file_format import find_model
from vapor.engines.engine import Device, Engine, EngineConfig, EngineName, Precision
from vapor.engines.start import describe, start_engine
from vapor.images import prepare, require_rgb
from vapor.landmarks.verify import LandmarkVerifier


class VaporObservationModel:
    """A pose regressor as an observation model: one encoder pass and `num_samples` poses an image.

    The filter takes the places among the samples, with the errors of the model's calibration. Where the model has a map
    of landmarks, places that these verify are known to centimetres.

    Arithmetic is float32 unless another precision is asked for; the poses that leave are float64. The latent noise
    comes from the caller's generator: the same image, generator state, engine, machine and number of threads give the
    same bits.

    Args:
        model: A trained model, or the description of one whose file the engine may look for.
        num_samples: Posterior samples per image.
        device: Where the network runs.
        camera: The camera of the images, undistorted, such as `SequenceReader.camera`; None where unknown. Images are
            resampled where its view differs from that of the training camera.
        engine: See `EngineConfig`.
        precision: Of the network's arithmetic.
        threads: Processor threads of OpenVINO's network.

    Attributes:
        description: Of the model.
        engine: Runs its network.
        camera: The camera of the images that come next.
        verifier: Makes places sharp where landmarks are seen; None where the model has none.
        verifies: Whether landmarks are looked for in the images that come next.

    Example:
        >>> import numpy as np
        >>> import vapor
        >>> model = vapor.VaporObservationModel.from_checkpoint("staircase")  # ships with the package; or a file
        >>> image = np.zeros((120, 160, 3), np.uint8)
        >>> posterior = model.observe(image, rng=np.random.default_rng(0))
        >>> posterior.is_out_of_distribution, len(posterior.samples)
        (True, 1000)
    """

    def __init__(
        self,
        model: Checkpoint | ModelDescription,
        *,
        num_samples: int = 1000,
        device: Device = "auto",
        camera: Camera | None = None,
        engine: EngineName = "auto",
        precision: Precision = "float32",
        threads: int = 1,
    ) -> None:
        if num_samples < 1:
            raise VaporTrackError(f"num_samples is {num_samples}, expected at least 1")
        self.description = model.description if isinstance(model, Checkpoint) else model
        self.num_samples = num_samples
        self.camera = camera
        self.engine: Engine = start_engine(model, EngineConfig(engine, precision), device=device, threads=threads)
        self._as_learned = AsTakenBy(self.description.camera, self.description.network.frame_size)
        self.verifier = _verifier(self.description)
        self.verifies = True

    @staticmethod
    def from_checkpoint(
        model: str | Checkpoint,
        *,
        num_samples: int = 1000,
        device: Device = "auto",
        camera: Camera | None = None,
        engine: EngineName = "auto",
        precision: Precision = "float32",
        threads: int = 1,
    ) -> VaporObservationModel:
        """The model of a file, of a name that ships with the package, or of a loaded checkpoint.

        Raises:
            CheckpointError: no such model, or an unusable file.
            VaporTrackError: an engine that is not installed, or does not go with the other settings.
        """
        return VaporObservationModel(
            describe(find_model(model)) if isinstance(model, str) else model,
            num_samples=num_samples,
            device=device,
            camera=camera,
            engine=engine,
            precision=precision,
            threads=threads,
        )

    def seen_by(self, camera: Camera | None) -> VaporObservationModel:
        """The same model with the same network, for images of a camera, without notices so far."""
        other, model = copy(self), self.description
        other.camera, other._as_learned = camera, AsTakenBy(model.camera, model.network.frame_size)
        other.verifier = _verifier(model)
        return other

    @cached_property
    def storeys(self) -> Storeys | None:
        """The storeys on which the model's training images were taken; None where there is one only."""
        return Storeys.found_in(self.description.prior_poses)

    @property
    def notices(self) -> list[str]:
        """Warnings and hints on the camera, from the images observed so far."""
        return self._as_learned.notices

    def observe(self, image: np.ndarray, *, rng: np.random.Generator) -> PosePosterior:
        """The posterior of one image, (H, W, 3) uint8 RGB of any size, from one pass of the network with latent noise.

        Raises:
            VaporTrackError: the image is not (H, W, 3) uint8.
        """
        posterior = self.propose(image, rng=rng)
        if self.verifier is None or not self.verifies:
            return posterior
        return self.verifier.verify(image, self.camera, posterior)

    def propose(self, image: np.ndarray, *, rng: np.random.Generator) -> PosePosterior:
        """The same by the network alone, without landmarks."""
        require_rgb(image)
        prepared = prepare(self._as_learned(image, self.camera), self.description.network)
        noise = rng.standard_normal((self.num_samples, self.engine.noise_dim), dtype=np.float32)
        seen = self.engine.run(prepared, noise)
        samples = Poses(seen.rotation.astype(np.float64), seen.translation.astype(np.float64))
        ood_score = self._ood_score(seen.description, self._as_learned.fraction)
        model = self.description
        return PosePosterior.from_samples(
            samples, model.calibration.errors, ood_score=ood_score, prior=model.training_prior
        )

    def ood_score(self, image: np.ndarray, camera: Camera | None) -> float:
        """How unlike the training images an image of a camera is, as `PosePosterior.ood_score`.

        Raises:
            VaporTrackError: the image is not (H, W, 3) uint8.
        """
        require_rgb(image)
        as_learned = AsTakenBy(self.description.camera, self.description.network.frame_size)
        prepared = prepare(as_learned(image, camera), self.description.network)
        noise = np.zeros((self.num_samples, self.engine.noise_dim), np.float32)
        return self._ood_score(self.engine.run(prepared, noise).description, as_learned.fraction)

    def is_verified(self, image: np.ndarray, camera: Camera | None) -> bool | None:
        """Whether landmarks verify a place in an image of a camera; None where the model has none.

        Raises:
            VaporTrackError: the image is not (H, W, 3) uint8.
        """
        other = self.seen_by(camera)
        if other.verifier is None:
            return None
        other.verifier.verify(image, camera, other.propose(image, rng=np.random.default_rng(0)))
        return bool(other.verifier.latest)

    def _ood_score(self, description: np.ndarray, fraction: float) -> float:
        """Score of an image by its description and the fraction of the view seen; 0 where the model has no scores."""
        if self.description.ood_model is None:
            return 0.0
        score = float(self.description.ood_model.ood_score(description[None])[0])
        is_unlike = score > OUT_OF_DISTRIBUTION + ood_allowance(fraction)
        return score if is_unlike else min(score, OUT_OF_DISTRIBUTION)


def _verifier(model: ModelDescription) -> LandmarkVerifier | None:
    noise = model.calibration.errors.verified
    return None if model.landmarks is None or noise is None else LandmarkVerifier(model.landmarks, noise)
