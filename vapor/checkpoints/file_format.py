"""The format of model files: a model -> one safetensors file and back; its description alone is read without torch."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from filtering.errors import quoted
from sequences.frame import Camera
from vapor.checkpoints.calibration import Calibration
from vapor.checkpoints.checkpoint import Checkpoint, ModelDescription, network_sha256
from vapor.checkpoints.scene_scale import MAX_PRIOR_POSES, spaced
from vapor.checkpoints.stored_config import parse_config, parse_metadata
from vapor.checkpoints.stored_tensors import (
    MEMORY,
    MEMORY_FIELDS,
    NETWORK,
    PRIOR,
    LandmarksConfig,
    float32,
    landmark_arrays,
    ood_model_arrays,
    refuse_surplus,
    take_landmarks,
    take_ood_model,
    take_poses,
    take_tensor,
)
from vapor.regressors.network_config import NetworkConfig, make_regressor
from vapor.regressors.ood_model import description_size
from vapor.regressors.scene_box import SceneBox
from vapor.tensor_files import CheckpointError, Stored, StoredTensor, format_of, read_stored, write_safetensors

if TYPE_CHECKING:
    from torch import Tensor

FORMAT = "vapor-track model"
VERSION = 12
ONNX = ".onnx"
"""Suffix of exported models."""
SHIPPED = Path(__file__).resolve().parents[1] / "models"
"""Folder of the models that ship."""


@dataclass(frozen=True)
class StoredConfig:
    """The configuration in a model file."""

    network: NetworkConfig
    box: SceneBox
    calibration: Calibration
    training: dict[str, Any]
    camera: Camera | None
    landmarks: LandmarksConfig | None


def description_metadata(model: ModelDescription | Checkpoint) -> dict[str, str]:
    """The metadata of a model file."""
    landmarks = None if model.landmarks is None else LandmarksConfig.of(model.landmarks)
    config = StoredConfig(model.network, model.box, model.calibration, dict(model.training), model.camera, landmarks)
    return {"format": FORMAT, "version": str(VERSION), "config": json.dumps(asdict(config), allow_nan=False)}


def description_arrays(model: ModelDescription | Checkpoint) -> dict[str, np.ndarray]:
    """Tensors of a model file beside weights and memory; more than 2000 prior poses are thinned evenly."""
    poses = model.prior_poses
    poses = poses[spaced(len(poses), MAX_PRIOR_POSES)]
    arrays = {f"{PRIOR}rotation": poses.rotation, f"{PRIOR}translation": poses.translation}
    arrays |= {} if model.ood_model is None else ood_model_arrays(model.ood_model)
    return arrays | ({} if model.landmarks is None else landmark_arrays(model.landmarks))


def parse_stored_config(path: Path, metadata: Mapping[str, str]) -> StoredConfig:
    """The configuration in the metadata of a model file.

    Raises:
        CheckpointError: another format or version, or a configuration with missing, surplus or unusable values.
    """
    found = metadata.get("format")
    if found != FORMAT:
        raise CheckpointError(f"{path}: format is {quoted(found)} in its metadata, expected {FORMAT!r}")
    version = metadata.get("version")
    if version != str(VERSION):
        raise CheckpointError(f"{path}: format version is {version!r}, expected '{VERSION}'; train the model again")
    return parse_config(path, "model", StoredConfig, parse_metadata(path, metadata.get("config")))


def parse_description(
    path: Path, config: StoredConfig, tensors: Mapping[str, StoredTensor], network_sha256: str
) -> ModelDescription:
    """A model's description from a file's configuration and tensors.

    Raises:
        CheckpointError: missing, surplus or unusable tensors, but for weights.
    """
    features = {MEMORY + name for name in MEMORY_FIELDS[:2]}
    left = {name: each for name, each in tensors.items() if not (name.startswith(NETWORK) or name in features)}
    description = ModelDescription(
        config.network,
        config.box,
        config.calibration,
        take_poses(path, left, PRIOR),
        network_sha256,
        take_poses(path, left, MEMORY) if f"{MEMORY}rotation" in left else None,
        training=config.training,
        ood_model=take_ood_model(path, left, description_size(config.network.backbone)),
        camera=config.camera,
        file=path,
        landmarks=None if config.landmarks is None else take_landmarks(path, left, config.landmarks),
    )
    refuse_surplus(path, left)
    return description


def save_checkpoint(path: Path, checkpoint: Checkpoint, *, store_float16: bool = False) -> None:
    """Write a model file, complete or not at all.

    Args:
        path: A file name, usually *.safetensors.
        checkpoint: The model; more than 2000 prior poses are thinned evenly.
        store_float16: Store weight matrices and the memory's features as float16, for half the size. Biases, BatchNorm
            and poses stay as they are.
    """
    import torch

    tensors: dict[str, Stored] = {**description_arrays(checkpoint)}
    for name, value in checkpoint.state_dict.items():
        smaller = store_float16 and value.is_floating_point() and value.ndim > 1
        tensors[NETWORK + name] = value.to(torch.float16) if smaller else value
    for name, value in checkpoint.memory.tensors().items() if checkpoint.memory else ():
        tensors[MEMORY + name] = value.to(torch.float16) if store_float16 and name in MEMORY_FIELDS[:2] else value
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

    config, tensors = _read(path)
    description = parse_description(path, config, tensors, "")
    with torch.device("meta"):  # names and shapes only, no memory
        regressor = make_regressor(config.network, config.box)
        expected = {NETWORK + name: value for name, value in regressor.state_dict().items()}
        if regressor.recalling is not None:
            count = len(description.memory_poses or ())
            shapes = regressor.recalling.memory_shapes()
            expected |= {MEMORY + name: torch.empty(count, *shape) for name, shape in shapes.items()}
    left = {name: each for name, each in tensors.items() if name.startswith((NETWORK, MEMORY))}
    found = {name: _as_expected(path, left, name, value) for name, value in expected.items()}
    refuse_surplus(path, left)
    weights = {name.removeprefix(NETWORK): value for name, value in found.items() if name.startswith(NETWORK)}
    memory = None
    if regressor.recalling is not None:
        memory = Memory(**{each.name: found[MEMORY + each.name] for each in fields(Memory)})
    return Checkpoint.of(description, weights, memory)


def _as_expected(path: Path, tensors: dict[str, StoredTensor], name: str, expected: Tensor) -> Tensor:
    """Take a tensor of this shape and kind of numbers out of a file's tensors; floating numbers become float32."""
    tensor = take_tensor(path, tensors, name).tensor()
    tensor = tensor.float() if tensor.is_floating_point() else tensor
    if (tensor.shape, tensor.dtype) != (expected.shape, expected.dtype):
        raise CheckpointError(
            f"{path}: tensor {name} has shape {tuple(tensor.shape)} and is of {tensor.dtype}, expected shape"
            f" {tuple(expected.shape)} and {expected.dtype}"
        )
    return tensor


def load_description(path: Path) -> ModelDescription:
    """Read a model file without its weights, of which only the digest is taken; torch is not imported.

    Raises:
        CheckpointError: as `load_checkpoint`, but for the weights.
    """
    config, tensors = _read(path)
    weights = {name.removeprefix(NETWORK): float32(v) for name, v in tensors.items() if name.startswith(NETWORK)}
    memory = [float32(tensors[MEMORY + name]) for name in MEMORY_FIELDS if MEMORY + name in tensors]
    return parse_description(path, config, tensors, network_sha256(config.network, config.box, weights, memory))


def _read(path: Path) -> tuple[StoredConfig, dict[str, StoredTensor]]:
    if is_onnx(path):
        raise CheckpointError(f"{path}: is an exported model, expected one that is not exported yet (*.safetensors)")
    metadata, tensors = read_stored(path)
    return parse_stored_config(path, metadata), tensors


def is_onnx(path: Path) -> bool:
    """Whether a model is an exported one, by the name of its file."""
    return path.suffix.lower() == ONNX


def require_model_name(path: Path) -> None:
    """Raise CheckpointError where a model file to write, no folder, has another name than of one."""
    if path.suffix.lower() != ".safetensors" and not path.is_dir():
        raise CheckpointError(f"{path}: expected the name of a model file to write, which ends in .safetensors")


def is_model(path: Path) -> bool:
    """Whether a file is a model of this package, by its metadata."""
    return format_of(path) == FORMAT


def shipped_models() -> tuple[str, ...]:
    """Names of the models that ship."""
    return tuple(sorted(file.stem for file in SHIPPED.glob("*.safetensors")))


def find_model(name_or_path: str) -> Path:
    """The file of a model: by its path, or by the name of a model that ships.

    Raises:
        CheckpointError: neither a file nor a shipped model; lists the shipped models.
    """
    path = Path(name_or_path)
    if path.is_file():
        return path
    shipped = SHIPPED / f"{name_or_path}.safetensors"
    if path.name == name_or_path and shipped.is_file():
        return shipped
    names = ", ".join(shipped_models()) or "none"
    raise CheckpointError(f"{name_or_path}: no such model file, expected one, or a model that ships: {names}")
