"""A trained model: network, weights, scene box, calibration and provenance; and its description without weights."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import KW_ONLY, asdict, dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from filtering.se3 import Poses
from filtering.training_prior import TrainingPrior
from sequences.frame import Camera
from vapor.checkpoints.calibration import Calibration
from vapor.checkpoints.stored_tensors import LandmarksConfig, landmark_arrays
from vapor.landmarks.verify import Landmarks
from vapor.regressors.network_config import NetworkConfig, make_regressor
from vapor.regressors.ood_model import OodModel
from vapor.regressors.scene_box import SceneBox

if TYPE_CHECKING:
    from torch import Tensor

    from vapor.regressors.base import PoseRegressor
    from vapor.regressors.retrieval import Memory


@dataclass(frozen=True)
class _Model:
    """Everything that a model consists of, but for the network's weights."""

    network: NetworkConfig
    """Shape of the network."""
    box: SceneBox
    """Box of predicted positions."""
    calibration: Calibration
    prior_poses: Poses
    """A posterior sample of each of n ≤ 2000 training images, batch (n,): they outline the scene."""
    _: KW_ONLY
    training: Mapping[str, Any] = field(default_factory=dict)
    """Provenance (data names, seed, images seen, validation figures); any JSON."""
    ood_model: OodModel | None = None
    """Descriptions of training images; None where they were never learned."""
    camera: Camera | None = None
    """The camera of the training images, undistorted; None where unknown."""
    file: Path | None = None
    """The file that it was read from; None of a model in memory."""
    landmarks: Landmarks | None = None
    """Points of the place, by which poses are found to centimetres; None where there are none."""

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names of the cameras whose images it learned from, that of the localized one first; empty where unknown."""
        named = self.training.get("cameras")
        return tuple(map(str, named)) if isinstance(named, list | tuple) else ()

    @cached_property
    def training_prior(self) -> TrainingPrior:
        """How often its network saw each place."""
        errors = self.calibration.errors
        return TrainingPrior(self.prior_poses, errors.radius_m, errors.radius_rad)


@dataclass(frozen=True)
class ModelDescription(_Model):
    """A model without its weights.

    Attributes:
        network_sha256: Digest of network, box, weights and memory, on which the posterior samples depend.
        memory_poses: True poses of the training images that a retrieval regressor remembers; None with any other.
    """

    network_sha256: str
    memory_poses: Poses | None = None


@dataclass(frozen=True)
class Checkpoint(_Model):
    """A trained model: everything that an observation model needs.

    Attributes:
        state_dict: Parameters and BatchNorm statistics of the `PoseRegressor`, float32 on the CPU.
        memory: The training images that a retrieval regressor remembers; None with any other.
    """

    state_dict: Mapping[str, Tensor]
    memory: Memory | None = None

    @staticmethod
    def of(description: ModelDescription, state_dict: Mapping[str, Tensor], memory: Memory | None) -> Checkpoint:
        """A model from its description."""
        return Checkpoint(**_shared(description), state_dict=state_dict, memory=memory)

    def build_network(self) -> PoseRegressor:
        """The network with its weights, on the CPU, in evaluation mode."""
        network = make_regressor(self.network, self.box)
        network.load_state_dict(dict(self.state_dict))
        network.memory = self.memory
        return network.eval()

    @property
    def description(self) -> ModelDescription:
        """The model without its weights."""
        memory = self.memory
        poses = None if memory is None else Poses(memory.rotation.double().numpy(), memory.translation.double().numpy())
        return ModelDescription(**_shared(self), network_sha256=self.network_sha256(), memory_poses=poses)

    def network_sha256(self) -> str:
        """Digest of network, box, weights and memory, on which the posterior samples depend."""
        weights = {name: value.numpy() for name, value in self.state_dict.items()}
        memory = self.memory.tensors().values() if self.memory else ()
        return network_sha256(self.network, self.box, weights, [value.numpy() for value in memory])

    def seen_sha256(self) -> str:
        """Digest of all that the network's result for an image depends on: weights, OOD model, camera, landmarks."""
        seen = hashlib.sha256(self.network_sha256().encode())
        for each in fields(self.ood_model) if self.ood_model else ():
            seen.update(each.name.encode() + np.asarray(getattr(self.ood_model, each.name)).tobytes())
        if self.camera is not None:
            seen.update(json.dumps(asdict(self.camera)).encode())
        if self.landmarks is not None:
            settings = asdict(LandmarksConfig.of(self.landmarks))
            seen.update(json.dumps({**settings, "verification": None}).encode())
            for name, value in landmark_arrays(self.landmarks).items():
                seen.update(name.encode() + np.ascontiguousarray(value).data)
        return seen.hexdigest()


def _shared(model: _Model) -> dict[str, Any]:
    return {each.name: getattr(model, each.name) for each in fields(_Model)}


def network_sha256(
    network: NetworkConfig, box: SceneBox, weights: Mapping[str, np.ndarray], memory: Iterable[np.ndarray]
) -> str:
    """Digest of a network by its shape, weights and, in the order of its fields, memory; numbers are float32."""
    digest = hashlib.sha256(json.dumps([asdict(network), asdict(box)], sort_keys=True).encode())
    for name in sorted(weights):
        digest.update(name.encode())
        digest.update(np.ascontiguousarray(weights[name]).data)
    for value in memory:
        digest.update(np.ascontiguousarray(value).data)
    return digest.hexdigest()
