"""What model files say beside the weights -> `ModelDescription`, every value checked."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from filtering.errors import quoted
from vapor.checkpoints.calibration import parse_calibration
from vapor.checkpoints.checkpoint import Checkpoint
from vapor.checkpoints.description import ModelDescription
from vapor.checkpoints.stored_config import parse_box, parse_camera, parse_config, parse_metadata
from vapor.checkpoints.stored_landmarks import landmark_arrays, landmarks_config, read_landmarks
from vapor.checkpoints.stored_tensors import (
    FAMILIARITY,
    MEMORY_ROTATION,
    MEMORY_TRANSLATION,
    PRIOR_ROTATION,
    PRIOR_TRANSLATION,
    familiarity_arrays,
    read_familiarity,
    read_poses,
)
from vapor.checkpoints.thinning import thin_poses
from vapor.regressors.network_config import NetworkConfig
from vapor.regressors.scene_box import SceneBox
from vapor.tensor_files import CheckpointError, StoredTensor

FORMAT = "vapor-track model"
VERSION = 10


class StoredConfig(NamedTuple):
    """Metadata of a model file, of which the network's shape was read.

    Attributes:
        network: Shape of the network.
        box: Box of predicted positions.
        training: Where the model came from.
        rest: All of the configuration, JSON.
    """

    network: NetworkConfig
    box: SceneBox
    training: dict[str, Any]
    rest: dict[str, Any]


def description_metadata(model: ModelDescription | Checkpoint) -> dict[str, str]:
    """The metadata of a model file."""
    config = {
        "network": asdict(model.network),
        "box": asdict(model.box),
        "calibration": asdict(model.calibration),
        "training": dict(model.training),
        "camera": None if model.camera is None else asdict(model.camera),
        "landmarks": None if model.landmarks is None else landmarks_config(model.landmarks),
    }
    return {"format": FORMAT, "version": str(VERSION), "config": json.dumps(config, allow_nan=False)}


def description_arrays(model: ModelDescription | Checkpoint) -> dict[str, np.ndarray]:
    """What a model file has as tensors beside weights and memory; more than 2000 prior poses are thinned evenly."""
    poses = thin_poses(model.prior_poses)
    arrays = {PRIOR_ROTATION: poses.rotation, PRIOR_TRANSLATION: poses.translation}
    arrays |= {} if model.familiarity is None else familiarity_arrays(model.familiarity)
    return arrays | ({} if model.landmarks is None else landmark_arrays(model.landmarks))


def parse_stored_config(path: Path, metadata: Mapping[str, str]) -> StoredConfig:
    """Metadata of a model file.

    Raises:
        CheckpointError: another format or version, or a configuration with missing, surplus or unusable values.
    """
    found = metadata.get("format")
    if found != FORMAT:
        raise CheckpointError(f"{path}: format is {quoted(found)} in its metadata, expected {FORMAT!r}")
    version = metadata.get("version")
    if version != str(VERSION):
        raise CheckpointError(f"{path}: format version is {version!r}, expected '{VERSION}'; train the model anew")
    config = parse_metadata(path, metadata.get("config"))
    network = parse_config(path, "network", NetworkConfig, config.get("network"))
    box = parse_box(path, config.get("box"))
    training = config.get("training")
    if not isinstance(training, dict):
        raise CheckpointError(f"{path}: training is {type(training).__name__} in its configuration, expected an object")
    return StoredConfig(network, box, training, config)


def parse_description(
    path: Path, config: StoredConfig, tensors: Mapping[str, StoredTensor], network_sha256: str
) -> ModelDescription:
    """The rest of a model file, once its tensors were checked.

    Args:
        path: The file.
        config: Its metadata.
        tensors: Its tensors beside the weights.
        network_sha256: Digest of its network.

    Raises:
        CheckpointError: unusable values.
    """
    known = any(name.startswith(FAMILIARITY) for name in tensors)
    return ModelDescription(
        config.network,
        config.box,
        parse_calibration(path, config.rest.get("calibration")),
        read_poses(tensors, PRIOR_ROTATION, PRIOR_TRANSLATION),
        network_sha256,
        config.training,
        read_familiarity(path, tensors) if known else None,
        parse_camera(path, config.rest.get("camera")),
        read_poses(tensors, MEMORY_ROTATION, MEMORY_TRANSLATION) if MEMORY_ROTATION in tensors else None,
        path,
        read_landmarks(path, config.rest.get("landmarks"), tensors),
    )
