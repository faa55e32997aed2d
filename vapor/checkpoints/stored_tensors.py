"""Tensors in a model file: what they are called, which ones a model needs, and whether those found are usable."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from types import MappingProxyType

import numpy as np

from filtering.errors import VaporTrackError
from filtering.se3 import Poses
from vapor.checkpoints.description import poses_of
from vapor.regressors.familiarity import Familiarity
from vapor.tensor_files import FLOATS, CheckpointError, StoredTensor

NETWORK = "network."
FAMILIARITY = "familiarity."
MEMORY = "memory."
"""What the names of tensors begin with in a file: weights of the network, what is familiar to it, what it remembers."""
PRIOR_ROTATION, PRIOR_TRANSLATION = "prior_poses.rotation", "prior_poses.translation"
"""Names of the tensors that hold the prior poses."""
MEMORY_ROTATION, MEMORY_TRANSLATION = f"{MEMORY}rotation", f"{MEMORY}translation"
"""Names of the tensors that hold the poses of what is remembered."""
LANDMARKS = "landmarks."
"""What the names of the tensors of landmarks begin with in a file."""
LANDMARKS_ROTATION = f"{LANDMARKS}rotation"
"""Name of the tensor that holds the rotations of the key images."""
MEMORY_FIELDS = "keys", "views", "translation", "rotation"
"""What is remembered of training images, in the order of `Memory`."""
HALVED_MEMORY = "keys", "views"
"""What of a memory is stored as float16 where that is asked for: poses are exact."""
POSES: Mapping[str, tuple[int, ...]] = MappingProxyType({"rotation": (3, 3), "translation": (3,)})
"""Shapes of what is remembered of an image by every regressor that remembers."""
_ORTHONORMAL_WITHIN = 1e-3

Shapes = Mapping[str, tuple[tuple[int, ...], str]]
"""Of each expected tensor: shape and type; any floating one will do for float32."""


def check_tensors(path: Path, tensors: Mapping[str, StoredTensor], beside_poses: Shapes) -> None:
    """Check that exactly the expected tensors and the prior poses are there: shapes, types, finite, rotations.

    Args:
        path: The file, for messages.
        tensors: What was found.
        beside_poses: Weights of the network, what is familiar to it and its memory.
    """
    expected = beside_poses.keys() | {PRIOR_ROTATION, PRIOR_TRANSLATION}
    for what, names in (("lacks", expected - tensors.keys()), ("has surplus", tensors.keys() - expected)):
        if names:
            raise CheckpointError(
                f"{path}: {what} tensor {min(names)} ({len(names)} such), expected exactly the {len(expected)} tensors"
                " of its configuration"
            )
    shape = tensors[PRIOR_TRANSLATION].shape
    count = shape[0] if shape else 0
    if count == 0:
        raise CheckpointError(f"{path}: tensor {PRIOR_TRANSLATION} is empty, expected at least one training pose")
    poses = {PRIOR_ROTATION: ((count, 3, 3), "float32"), PRIOR_TRANSLATION: ((count, 3), "float32")}
    for name, (shape, dtype) in {**beside_poses, **poses}.items():
        found = tensors[name]
        if found.shape != shape:
            raise CheckpointError(f"{path}: tensor {name} has shape {found.shape}, expected {shape}")
        kinds = FLOATS if dtype in FLOATS else (dtype,)
        if found.dtype not in kinds:
            wanted = " or ".join(f"torch.{kind}" for kind in kinds)
            raise CheckpointError(f"{path}: tensor {name} is of torch.{found.dtype}, expected {wanted}")
        if not np.isfinite(found.array()).all():
            raise CheckpointError(f"{path}: tensor {name} has values that are not finite")
    for name in (PRIOR_ROTATION, *sorted({MEMORY_ROTATION, LANDMARKS_ROTATION} & tensors.keys())):
        _require_rotations(path, name, tensors[name].array())


def _require_rotations(path: Path, name: str, matrices: np.ndarray) -> None:
    rotation = matrices.astype(np.float64)
    with np.errstate(all="ignore"):  # of huge numbers and zeros; NaN compares as false
        skew = np.abs(np.swapaxes(rotation, 1, 2) @ rotation - np.eye(3)).max(axis=(1, 2))
        wrong = ~((skew <= _ORTHONORMAL_WITHIN) & (np.linalg.det(rotation) > 0))
    if wrong.any():
        raise CheckpointError(
            f"{path}: tensor {name} has {int(wrong.sum())} matrices that are not rotations, the first is number"
            f" {int(wrong.argmax())}; expected RᵀR = I within {_ORTHONORMAL_WITHIN} and det R = 1"
        )


def float32(tensor: StoredTensor) -> np.ndarray:
    """Numbers as a model is used with: floating ones as float32, whole ones as they are."""
    return tensor.array().astype(np.float32) if tensor.dtype in FLOATS else tensor.array()


def read_poses(tensors: Mapping[str, StoredTensor], rotation: str, translation: str) -> Poses:
    """Poses (n,) from tensors that were checked, by their names."""
    return poses_of(tensors[rotation].array(), tensors[translation].array())


def familiarity_arrays(familiarity: Familiarity) -> dict[str, np.ndarray]:
    """What is familiar to a network, as it is stored: matrices as float16, the rest as float32."""
    found = {each.name: np.asarray(getattr(familiarity, each.name)) for each in fields(Familiarity)}
    return {
        FAMILIARITY + name: value.astype(np.float16 if value.ndim == 2 else np.float32) for name, value in found.items()
    }


def familiarity_shapes(tensors: Mapping[str, StoredTensor], size: int) -> Shapes:
    """What of `familiarity_arrays` a file must have; none if it has none of it.

    Args:
        tensors: Of the file; its exemplars say how many exemplars and axes there should be.
        size: How many features of an image the network has.
    """
    if not any(name.startswith(FAMILIARITY) for name in tensors):
        return {}
    exemplars = tensors.get(FAMILIARITY + "exemplars")
    shape = exemplars.shape if exemplars is not None and len(exemplars.shape) == 2 else (1, 1)
    count, axes = (max(1, number) for number in shape)
    shapes = {
        "centre": (size,), "scale": (size,), "axes": (size, axes), "stretch": (axes,), "exemplars": (count, axes),
        "own_distance": (), "threshold": (),
    }  # fmt: skip
    return {FAMILIARITY + name: (shape, "float32") for name, shape in shapes.items()}


def read_familiarity(path: Path, tensors: Mapping[str, StoredTensor]) -> Familiarity:
    """What is familiar to a network, from tensors that were checked.

    Raises:
        CheckpointError: values that cannot be used.
    """
    found = {name: float32(tensors[FAMILIARITY + name]) for name in (f.name for f in fields(Familiarity))}
    try:
        own_distance, threshold = (float(found.pop(name)) for name in ("own_distance", "threshold"))
        return Familiarity(**found, own_distance=own_distance, threshold=threshold)
    except VaporTrackError as error:
        raise CheckpointError(f"{path}: {error}") from error


def memory_shapes(tensors: Mapping[str, StoredTensor], of_one_image: Mapping[str, tuple[int, ...]]) -> Shapes:
    """What a file must have of what a retrieval regressor remembers.

    Args:
        tensors: Of the file; the first of those expected says how many images there should be.
        of_one_image: Shapes of what is remembered of one image, by name.
    """
    first = [tensors[MEMORY + name].shape for name in of_one_image if MEMORY + name in tensors][:1]
    count = max(1, first[0][0]) if first and first[0] else 1
    return {MEMORY + name: ((count, *shape), "float32") for name, shape in of_one_image.items()}
