"""Tensors in a model file: what they are called, which ones a model needs, and whether those found are usable."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path

import torch
from torch import Tensor

from filtering.errors import VaporTrackError
from vapor.regressors.base import PoseRegressor
from vapor.regressors.familiarity import Familiarity
from vapor.regressors.memory import Memory
from vapor.tensor_files import CheckpointError

NETWORK = "network."
FAMILIARITY = "familiarity."
MEMORY = "memory."
"""What the names of tensors begin with in a file: weights of the network, what is familiar to it, what it remembers."""
PRIOR_ROTATION, PRIOR_TRANSLATION = "prior_poses.rotation", "prior_poses.translation"
"""Names of the tensors that hold the prior poses."""
_MEMORY_FLOAT16 = "keys", "views"  # poses are exact
_FLOATS = (torch.float16, torch.bfloat16, torch.float32, torch.float64)
_ORTHONORMAL_WITHIN = 1e-3


def check_tensors(path: Path, tensors: Mapping[str, Tensor], network: Mapping[str, Tensor]) -> None:
    """Check that exactly the expected tensors and the prior poses are there: shapes, types, finite, rotations.

    Args:
        path: The file, for messages.
        tensors: What was found.
        network: Tensors of the shapes and types (floating or not) that the network, what is familiar to it and its
            memory have.
    """
    expected = network.keys() | {PRIOR_ROTATION, PRIOR_TRANSLATION}
    for what, names in (("lacks", expected - tensors.keys()), ("has surplus", tensors.keys() - expected)):
        if names:
            raise CheckpointError(
                f"{path}: {what} tensor {min(names)} ({len(names)} such), expected exactly the {len(expected)} tensors"
                " of its configuration"
            )
    count = tensors[PRIOR_TRANSLATION].shape[0] if tensors[PRIOR_TRANSLATION].ndim else 0
    if count == 0:
        raise CheckpointError(f"{path}: tensor {PRIOR_TRANSLATION} is empty, expected at least one training pose")
    poses = {PRIOR_ROTATION: torch.empty(count, 3, 3), PRIOR_TRANSLATION: torch.empty(count, 3)}
    for name, like in {**network, **poses}.items():
        found = tensors[name]
        if found.shape != like.shape:
            raise CheckpointError(f"{path}: tensor {name} has shape {tuple(found.shape)}, expected {tuple(like.shape)}")
        kinds = _FLOATS if like.is_floating_point() else (like.dtype,)
        if found.dtype not in kinds:
            raise CheckpointError(f"{path}: tensor {name} is of {found.dtype}, expected {' or '.join(map(str, kinds))}")
        if not torch.isfinite(found).all():
            raise CheckpointError(f"{path}: tensor {name} has values that are not finite")
    _require_rotations(path, PRIOR_ROTATION, tensors[PRIOR_ROTATION])


def _require_rotations(path: Path, name: str, matrices: Tensor) -> None:
    rotation = matrices.double()
    skew = (rotation.mT @ rotation - torch.eye(3, dtype=torch.float64)).abs().amax(dim=(1, 2))
    wrong = ~((skew <= _ORTHONORMAL_WITHIN) & (torch.linalg.det(rotation) > 0))
    if wrong.any():
        raise CheckpointError(
            f"{path}: tensor {name} has {int(wrong.sum())} matrices that are not rotations, the first is number"
            f" {int(wrong.int().argmax())}; expected RᵀR = I within {_ORTHONORMAL_WITHIN} and det R = 1"
        )


def familiarity_tensors(familiarity: Familiarity) -> dict[str, Tensor]:
    """What is familiar to a network, as it is stored: matrices as float16, the rest as float32."""
    found = {name: torch.as_tensor(value) for name, value in vars(familiarity).items()}
    return {
        FAMILIARITY + name: value.to(torch.float16 if value.ndim == 2 else torch.float32)
        for name, value in found.items()
    }


def familiarity_like(tensors: Mapping[str, Tensor], size: int) -> dict[str, Tensor]:
    """Tensors of the names and shapes that `familiarity_tensors` must have in a file; none if the file has none.

    Args:
        tensors: Of the file; its exemplars say how many exemplars and axes there should be.
        size: How many features of an image the network has.
    """
    if not any(name.startswith(FAMILIARITY) for name in tensors):
        return {}
    exemplars = tensors.get(FAMILIARITY + "exemplars")
    shape = exemplars.shape if exemplars is not None and exemplars.ndim == 2 else (1, 1)
    count, axes = (max(1, number) for number in shape)
    shapes = {
        "centre": (size,), "scale": (size,), "axes": (size, axes), "stretch": (axes,), "exemplars": (count, axes),
        "own_distance": (), "threshold": (),
    }  # fmt: skip
    return {FAMILIARITY + name: torch.empty(shape) for name, shape in shapes.items()}


def read_familiarity(path: Path, tensors: Mapping[str, Tensor]) -> Familiarity:
    """What is familiar to a network, from tensors whose names and shapes were checked.

    Raises:
        CheckpointError: values that cannot be used.
    """
    found = {name: tensors[FAMILIARITY + name].float() for name in (f.name for f in fields(Familiarity))}
    try:
        numbers = {name: float(found.pop(name)) for name in ("own_distance", "threshold")}
        return Familiarity(**{name: value.numpy() for name, value in found.items()}, **numbers)  # pyright: ignore[reportArgumentType]
    except VaporTrackError as error:
        raise CheckpointError(f"{path}: {error}") from error


def memory_tensors(memory: Memory, *, store_float16: bool) -> dict[str, Tensor]:
    """What a retrieval regressor remembers, as it is stored: poses always in full precision."""
    return {
        MEMORY + name: value.to(torch.float16) if store_float16 and name in _MEMORY_FLOAT16 else value
        for name, value in memory.tensors().items()
    }


def memory_like(tensors: Mapping[str, Tensor], regressor: PoseRegressor) -> dict[str, Tensor]:
    """Tensors of the names and shapes that `memory_tensors` must have in a file; none for regressors without a memory.

    Args:
        tensors: Of the file; its keys say how many images there should be.
        regressor: The network of the file.
    """
    recalling = regressor.recalling
    if recalling is None:
        return {}
    keys = tensors.get(MEMORY + "keys")
    count = max(1, len(keys)) if keys is not None and keys.ndim == 2 else 1
    return {MEMORY + name: torch.empty(count, *shape) for name, shape in recalling.memory_shapes().items()}


def read_memory(path: Path, tensors: Mapping[str, Tensor]) -> Memory:
    """What a retrieval regressor remembers, from tensors whose names and shapes were checked.

    Raises:
        CheckpointError: matrices that are not rotations.
    """
    memory = Memory(**{field.name: tensors[MEMORY + field.name].float() for field in fields(Memory)})
    _require_rotations(path, MEMORY + "rotation", memory.rotation)
    return memory
