"""The format of model files: a model -> one safetensors file and back; its description alone is read without torch."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path

from vapor.checkpoints.checkpoint import Checkpoint, network_sha256
from vapor.checkpoints.description import ModelDescription
from vapor.checkpoints.stored_description import (
    FORMAT,
    StoredConfig,
    description_arrays,
    description_metadata,
    parse_description,
    parse_stored_config,
)
from vapor.checkpoints.stored_landmarks import landmark_shapes
from vapor.checkpoints.stored_tensors import (
    HALVED_MEMORY,
    MEMORY,
    MEMORY_FIELDS,
    MEMORY_ROTATION,
    NETWORK,
    POSES,
    Shapes,
    check_tensors,
    familiarity_shapes,
    float32,
    memory_shapes,
)
from vapor.regressors.familiarity import description_size
from vapor.regressors.registry import make_regressor
from vapor.tensor_files import CheckpointError, StoredTensor, format_of, read_stored, write_safetensors

ONNX = ".onnx"
"""How names of exported models end."""


def save_checkpoint(path: Path, checkpoint: Checkpoint, *, store_float16: bool = False) -> None:
    """Write a model file, complete or not at all.

    Args:
        path: A file name, usually *.safetensors.
        checkpoint: What to write; more than 2000 prior poses are thinned evenly.
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

    from vapor.regressors.memory import Memory

    _refuse_exported(path)
    metadata, tensors = read_stored(path)
    config = parse_stored_config(path, metadata)
    with torch.device("meta"):  # names and shapes only, no memory
        regressor = make_regressor(config.network, config.box)
    weights = regressor.state_dict()
    recalling = regressor.recalling
    expected = {NETWORK + name: (tuple(v.shape), str(v.dtype).removeprefix("torch.")) for name, v in weights.items()}
    known = familiarity_shapes(tensors, description_size(config.network.backbone))
    remembered = {} if recalling is None else memory_shapes(tensors, recalling.memory_shapes())
    check_tensors(path, tensors, {**expected, **known, **remembered, **landmark_shapes(tensors)})
    model = parse_description(path, config, tensors, "")

    def read(name: str) -> torch.Tensor:
        tensor = tensors[name].tensor()
        return tensor.float() if tensor.is_floating_point() else tensor

    memory = None if recalling is None else Memory(**{f.name: read(MEMORY + f.name) for f in fields(Memory)})
    return Checkpoint(
        config.network,
        config.box,
        model.calibration,
        model.prior_poses,
        {name: read(NETWORK + name) for name in weights},
        config.training,
        model.familiarity,
        model.camera,
        memory,
        path,
        model.landmarks,
    )


def load_description(path: Path) -> ModelDescription:
    """Read what a model file says beside its weights, which are not looked at but for their digest; without torch.

    Raises:
        CheckpointError: as `load_checkpoint`, but for the weights.
    """
    _refuse_exported(path)
    metadata, tensors = read_stored(path)
    config = parse_stored_config(path, metadata)
    weights = {name: value for name, value in tensors.items() if name.startswith((NETWORK, MEMORY))}
    rest = {name: value for name, value in tensors.items() if name not in weights or name.removeprefix(MEMORY) in POSES}
    check_tensors(path, rest, shapes_beside_weights(config, rest))
    return parse_description(path, config, rest, _digest(config, weights))


def is_onnx(path: Path) -> bool:
    """Whether a model is an exported one, by the name of its file."""
    return path.suffix.lower() == ONNX


def _refuse_exported(path: Path) -> None:
    if is_onnx(path):
        raise CheckpointError(f"{path}: is an exported model, expected one that is not exported yet (*.safetensors)")


def shapes_beside_weights(config: StoredConfig, tensors: Mapping[str, StoredTensor]) -> Shapes:
    """What of its description a file must have as tensors, beside the prior poses."""
    known = familiarity_shapes(tensors, description_size(config.network.backbone))
    remembered = memory_shapes(tensors, POSES) if MEMORY_ROTATION in tensors else {}
    return {**known, **remembered, **landmark_shapes(tensors)}


def is_model(path: Path) -> bool:
    """Whether a file is a model of this package, by what it says of itself."""
    return format_of(path) == FORMAT


def _digest(config: StoredConfig, weights: Mapping[str, StoredTensor]) -> str:
    """As `Checkpoint.network_sha256`."""
    network = {name.removeprefix(NETWORK): float32(v) for name, v in weights.items() if name.startswith(NETWORK)}
    memory = [float32(weights[MEMORY + name]) for name in MEMORY_FIELDS if MEMORY + name in weights]
    return network_sha256(config.network, config.box, network, memory)
