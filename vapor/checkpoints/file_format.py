"""The format of model files: a model -> one safetensors file and back; its description alone is read without torch."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from filtering.errors import quoted
from vapor.checkpoints.calibration import Calibration
from vapor.checkpoints.checkpoint import Checkpoint, ModelDescription, network_sha256
from vapor.checkpoints.scene_scale import MAX_PRIOR_POSES, spaced
from vapor.checkpoints.stored_config import parse_camera, parse_config, parse_metadata
from vapor.checkpoints.stored_tensors import (
    HALVED_MEMORY,
    MEMORY,
    MEMORY_FIELDS,
    MEMORY_ROTATION,
    MEMORY_TRANSLATION,
    NETWORK,
    OOD_MODEL,
    POSES,
    PRIOR_ROTATION,
    PRIOR_TRANSLATION,
    Shapes,
    check_tensors,
    float32,
    landmark_arrays,
    landmark_shapes,
    landmarks_config,
    memory_shapes,
    ood_model_arrays,
    ood_model_shapes,
    read_landmarks,
    read_ood_model,
    read_poses,
)
from vapor.regressors.network_config import NetworkConfig, make_regressor
from vapor.regressors.ood_model import description_size
from vapor.regressors.scene_box import SceneBox
from vapor.storage import fetched, is_url, local_path
from vapor.tensor_files import CheckpointError, StoredTensor, format_of, read_stored, write_safetensors

FORMAT = "vapor-track model"
VERSION = 11
ONNX = ".onnx"
"""Suffix of exported models."""
SHIPPED = Path(__file__).resolve().parents[1] / "models"
"""Folder of the models that ship."""


class StoredConfig(NamedTuple):
    """Metadata of a model file: the parsed shape of the network, and in `rest` all of the configuration, JSON."""

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
    """Tensors of a model file beside weights and memory; more than 2000 prior poses are thinned evenly."""
    poses = model.prior_poses
    poses = poses[spaced(len(poses), MAX_PRIOR_POSES)]
    arrays = {PRIOR_ROTATION: poses.rotation, PRIOR_TRANSLATION: poses.translation}
    arrays |= {} if model.ood_model is None else ood_model_arrays(model.ood_model)
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
        raise CheckpointError(f"{path}: format version is {version!r}, expected '{VERSION}'; train the model again")
    config = parse_metadata(path, metadata.get("config"))
    network = parse_config(path, "network", NetworkConfig, config.get("network"))
    box = parse_config(path, "box", SceneBox, config.get("box"))
    training = config.get("training")
    if not isinstance(training, dict):
        raise CheckpointError(f"{path}: training is {type(training).__name__} in its configuration, expected an object")
    return StoredConfig(network, box, training, config)


def parse_description(
    path: Path, config: StoredConfig, tensors: Mapping[str, StoredTensor], network_sha256: str
) -> ModelDescription:
    """The rest of a model file, once its tensors were checked.

    Raises:
        CheckpointError: unusable values.
    """
    known = any(name.startswith(OOD_MODEL) for name in tensors)
    return ModelDescription(
        config.network,
        config.box,
        parse_config(path, "calibration", Calibration, config.rest.get("calibration")),
        read_poses(tensors, PRIOR_ROTATION, PRIOR_TRANSLATION),
        network_sha256,
        read_poses(tensors, MEMORY_ROTATION, MEMORY_TRANSLATION) if MEMORY_ROTATION in tensors else None,
        training=config.training,
        ood_model=read_ood_model(path, tensors) if known else None,
        camera=parse_camera(path, config.rest.get("camera")),
        file=path,
        landmarks=read_landmarks(path, config.rest.get("landmarks"), tensors),
    )


def save_checkpoint(path: Path, checkpoint: Checkpoint, *, store_float16: bool = False) -> None:
    """Write a model file, complete or not at all.

    Args:
        path: A file name, usually *.safetensors.
        checkpoint: The model; more than 2000 prior poses are thinned evenly.
        store_float16: Store weight matrices as float16, for half the size; biases and BatchNorm stay float32.
    """
    import torch

    tensors = {name: torch.as_tensor(value) for name, value in description_arrays(checkpoint).items()}
    for name, value in checkpoint.state_dict.items():
        smaller = store_float16 and value.is_floating_point() and value.ndim > 1
        tensors[NETWORK + name] = value.to(torch.float16) if smaller else value
    for name, value in checkpoint.memory.tensors().items() if checkpoint.memory else ():
        tensors[MEMORY + name] = value.to(torch.float16) if store_float16 and name in HALVED_MEMORY else value
    write_safetensors(path, tensors, description_metadata(checkpoint))


def load_checkpoint(path: Path) -> Checkpoint:
    """Read a model file, strictly.

    Raises:
        CheckpointError: no such file, no safetensors file, a damaged one, another format or version, a configuration
            with missing, surplus or unusable values, tensors that are missing, surplus, misshapen, of another type or
            not finite, or poses that are not rigid.
    """
    import torch

    from vapor.regressors.retrieval import Memory

    _refuse_exported(path)
    metadata, tensors = read_stored(path)
    config = parse_stored_config(path, metadata)
    with torch.device("meta"):  # names and shapes only, no memory
        regressor = make_regressor(config.network, config.box)
    weights = regressor.state_dict()
    recalling = regressor.recalling
    expected = {NETWORK + name: (tuple(v.shape), str(v.dtype).removeprefix("torch.")) for name, v in weights.items()}
    remembered = {} if recalling is None else memory_shapes(tensors, recalling.memory_shapes())
    rest = {name: value for name, value in tensors.items() if not name.startswith(MEMORY)}
    check_tensors(path, tensors, {**expected, **remembered, **shapes_beside_weights(config, rest)})
    model = parse_description(path, config, tensors, "")

    def read(name: str) -> torch.Tensor:
        tensor = tensors[name].tensor()
        return tensor.float() if tensor.is_floating_point() else tensor

    memory = None if recalling is None else Memory(**{f.name: read(MEMORY + f.name) for f in fields(Memory)})
    return Checkpoint.of(model, {name: read(NETWORK + name) for name in weights}, memory)


def load_description(path: Path) -> ModelDescription:
    """Read a model file without its weights, of which only the digest is taken; torch is not imported.

    Raises:
        CheckpointError: as `load_checkpoint`, but for the weights.
    """
    _refuse_exported(path)
    metadata, tensors = read_stored(path)
    config = parse_stored_config(path, metadata)
    weights = {name: value for name, value in tensors.items() if name.startswith((NETWORK, MEMORY))}
    rest = {name: value for name, value in tensors.items() if name not in weights or name.removeprefix(MEMORY) in POSES}
    check_tensors(path, rest, shapes_beside_weights(config, rest))
    network = {name.removeprefix(NETWORK): float32(v) for name, v in weights.items() if name.startswith(NETWORK)}
    memory = [float32(weights[MEMORY + name]) for name in MEMORY_FIELDS if MEMORY + name in weights]
    return parse_description(path, config, rest, network_sha256(config.network, config.box, network, memory))


def is_onnx(path: Path) -> bool:
    """Whether a model is an exported one, by the name of its file."""
    return path.suffix.lower() == ONNX


def _refuse_exported(path: Path) -> None:
    if is_onnx(path):
        raise CheckpointError(f"{path}: is an exported model, expected one that is not exported yet (*.safetensors)")


def shapes_beside_weights(config: StoredConfig, tensors: Mapping[str, StoredTensor]) -> Shapes:
    """Shapes of the tensors that a file must have beside weights and prior poses."""
    known = ood_model_shapes(tensors, description_size(config.network.backbone))
    remembered = memory_shapes(tensors, POSES) if MEMORY_ROTATION in tensors else {}
    return {**known, **remembered, **landmark_shapes(tensors)}


def is_model(path: Path) -> bool:
    """Whether the metadata of a file are those of a model of this package."""
    return format_of(path) == FORMAT


def find_model(name_or_path: str) -> Path:
    """The file of a model: by a path, a URL, which is copied, or the name of a model that ships.

    Raises:
        CheckpointError: neither a file nor a shipped model; lists those that ship.
    """
    path = fetched(local_path(name_or_path)) if is_url(name_or_path) else Path(name_or_path)
    if path.is_file():
        return path
    shipped = SHIPPED / f"{name_or_path}.safetensors"
    if path.name == name_or_path and shipped.is_file():
        return shipped
    names = ", ".join(sorted(p.stem for p in SHIPPED.glob("*.safetensors"))) or "none"
    raise CheckpointError(f"{name_or_path}: no such model file, expected one, or a model that ships: {names}")
