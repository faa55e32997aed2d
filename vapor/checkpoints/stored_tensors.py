"""Tensors in a model file: names, shapes, and checks of those found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, fields
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from filtering.errors import VaporTrackError, quoted
from filtering.se3 import Poses
from vapor.checkpoints.stored_config import parse_camera, parse_config
from vapor.landmarks.features import SIFT_SIZE, SIZE
from vapor.landmarks.landmark_map import LandmarkMap, ViewCamera
from vapor.landmarks.verify import Landmarks, Verification
from vapor.regressors.ood_model import OodModel
from vapor.tensor_files import FLOATS, CheckpointError, StoredTensor

NETWORK = "network."
OOD_MODEL = "ood_model."
MEMORY = "memory."
"""Prefixes of the names of tensors in a file: weights of the network, OOD model, memory."""
PRIOR_ROTATION, PRIOR_TRANSLATION = "prior_poses.rotation", "prior_poses.translation"
"""Names of the tensors that hold the prior poses."""
MEMORY_ROTATION, MEMORY_TRANSLATION = f"{MEMORY}rotation", f"{MEMORY}translation"
"""Names of the tensors that hold the poses in memory."""
LANDMARKS = "landmarks."
"""Prefix of the names of the tensors of landmarks in a file."""
LANDMARKS_ROTATION = f"{LANDMARKS}rotation"
"""Name of the tensor that holds the rotations of the key images."""
MEMORY_FIELDS = "keys", "views", "translation", "rotation"
"""The memory of training images, in the order of `Memory`."""
HALVED_MEMORY = "keys", "views"
"""What of a memory is stored as float16 where that is asked for: poses are exact."""
POSES: Mapping[str, tuple[int, ...]] = MappingProxyType({"rotation": (3, 3), "translation": (3,)})
"""Shapes of the poses in memory of one image."""
_ORTHONORMAL_WITHIN = 1e-3

Shapes = Mapping[str, tuple[tuple[int, ...], str]]
"""Of each expected tensor: shape and type; any floating one will do for float32."""
_ARRAYS = (
    "points", "descriptors", "rotation", "translation", "begins", "shown", "mean", "axes", "words", "summary_axes",
    "summaries",
)  # fmt: skip
_HALVED = "summary_axes", "summaries"  # stored as float16
_NUMBERS = "depth_m", "k1", "k2"


def check_tensors(path: Path, tensors: Mapping[str, StoredTensor], beside_poses: Shapes) -> None:
    """Check that exactly the prior poses and the other expected tensors are there: shapes, types, finite, rotations."""
    expected = beside_poses.keys() | {PRIOR_ROTATION, PRIOR_TRANSLATION}
    for fault, names in (("lacks", expected - tensors.keys()), ("has surplus", tensors.keys() - expected)):
        if names:
            raise CheckpointError(
                f"{path}: {fault} tensor {min(names)} ({len(names)} such), expected exactly the {len(expected)} tensors"
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


def poses_of(rotation: np.ndarray, translation: np.ndarray) -> Poses:
    """Poses (n,) of matrices (n, 3, 3) and positions (n, 3) of any precision."""
    return Poses(rotation.astype(np.float64), translation.astype(np.float64))


def read_poses(tensors: Mapping[str, StoredTensor], rotation: str, translation: str) -> Poses:
    """Poses (n,) from tensors that were checked, by their names."""
    return poses_of(tensors[rotation].array(), tensors[translation].array())


def ood_model_arrays(ood_model: OodModel) -> dict[str, np.ndarray]:
    """The OOD model as tensors of a model file: matrices as float16, the rest as float32."""
    found = {each.name: np.asarray(getattr(ood_model, each.name)) for each in fields(OodModel)}
    return {
        OOD_MODEL + name: value.astype(np.float16 if value.ndim == 2 else np.float32) for name, value in found.items()
    }


def ood_model_shapes(tensors: Mapping[str, StoredTensor], size: int) -> Shapes:
    """Shapes of `ood_model_arrays` in a file whose network gives so many features; empty if it has none of them.

    The tensor of exemplars determines how many exemplars and axes there should be.
    """
    if not any(name.startswith(OOD_MODEL) for name in tensors):
        return {}
    exemplars = tensors.get(OOD_MODEL + "exemplars")
    shape = exemplars.shape if exemplars is not None and len(exemplars.shape) == 2 else (1, 1)
    count, axes = (max(1, number) for number in shape)
    shapes = {
        "centre": (size,), "scale": (size,), "axes": (size, axes), "stretch": (axes,), "exemplars": (count, axes),
        "own_distance": (), "threshold": (),
    }  # fmt: skip
    return {OOD_MODEL + name: (shape, "float32") for name, shape in shapes.items()}


def read_ood_model(path: Path, tensors: Mapping[str, StoredTensor]) -> OodModel:
    """The OOD model from tensors that were checked.

    Raises:
        CheckpointError: values that cannot be used.
    """
    found = {name: float32(tensors[OOD_MODEL + name]) for name in (f.name for f in fields(OodModel))}
    try:
        own_distance, threshold = (float(found.pop(name)) for name in ("own_distance", "threshold"))
        return OodModel(**found, own_distance=own_distance, threshold=threshold)
    except VaporTrackError as error:
        raise CheckpointError(f"{path}: {error}") from error


def memory_shapes(tensors: Mapping[str, StoredTensor], of_one_image: Mapping[str, tuple[int, ...]]) -> Shapes:
    """Shapes of the memory of a retrieval regressor in a file, given those of one image by name.

    The first tensor that is there determines how many images there should be.
    """
    first = [tensors[MEMORY + name].shape for name in of_one_image if MEMORY + name in tensors][:1]
    count = max(1, first[0][0]) if first and first[0] else 1
    return {MEMORY + name: ((count, *shape), "float32") for name, shape in of_one_image.items()}


def landmark_arrays(landmarks: Landmarks) -> dict[str, np.ndarray]:
    """Landmarks as tensors of a model file."""
    found = {name: np.asarray(getattr(landmarks.map, name)) for name in _ARRAYS}
    return {LANDMARKS + name: v.astype(np.float16) if name in _HALVED else v for name, v in found.items()}


def landmarks_config(landmarks: Landmarks) -> dict[str, Any]:
    """The rest, as JSON."""
    m = landmarks.map
    return {
        "stated": None if m.stated is None else asdict(m.stated),
        "camera": asdict(m.camera.camera),
        "k1": m.camera.k1,
        "k2": m.camera.k2,
        "depth_m": m.depth_m,
        "verification": asdict(landmarks.verification),
    }


def landmark_shapes(tensors: Mapping[str, StoredTensor]) -> Shapes:
    """Shapes of `landmark_arrays` in a file; empty if it has none of them."""
    if not any(name.startswith(LANDMARKS) for name in tensors):
        return {}

    def size(name: str, axis: int) -> int:
        found = tensors.get(LANDMARKS + name)
        return max(1, found.shape[axis]) if found is not None and len(found.shape) > axis else 1

    points, images, words = size("points", 0), size("rotation", 0), size("words", 0)
    numbers, summary = min(size("axes", 1), SIZE), size("summaries", 1)
    shapes = {
        "points": ((points, 3), "float32"), "descriptors": ((points, numbers), "int8"),
        "rotation": ((images, 3, 3), "float32"), "translation": ((images, 3), "float32"),
        "begins": ((images + 1,), "int32"), "shown": ((size("shown", 0),), "int32"),
        "mean": ((SIFT_SIZE,), "float32"), "axes": ((SIFT_SIZE, numbers), "float32"),
        "words": ((words, numbers), "float32"), "summary_axes": ((words * numbers, summary), "float32"),
        "summaries": ((images, summary), "float32"),
    }  # fmt: skip
    return {LANDMARKS + name: shape for name, shape in shapes.items()}


def read_landmarks(path: Path, values: Any, tensors: Mapping[str, StoredTensor]) -> Landmarks | None:
    """Landmarks from settings and tensors that were checked; None where a file has none.

    Raises:
        CheckpointError: one without the other, missing, surplus or unusable values, or points that are not there.
    """
    stored = any(name.startswith(LANDMARKS) for name in tensors)
    if values is None and not stored:
        return None
    expected = {"stated", "camera", "verification", *_NUMBERS}
    if not stored or not isinstance(values, dict) or values.keys() != expected:
        raise CheckpointError(
            f"{path}: landmarks configuration is {quoted(values)} with {'' if stored else 'no '}tensors of landmarks,"
            f" expected both, and {', '.join(sorted(expected))}"
        )
    for name in _NUMBERS:
        if type(values[name]) not in (int, float) or not np.isfinite(values[name]):
            raise CheckpointError(
                f"{path}: landmarks configuration has {name} {quoted(values[name])}, expected a number"
            )
    stated, camera = (parse_camera(path, values[name]) for name in ("stated", "camera"))
    if camera is None or not values["depth_m"] > 0.0:
        raise CheckpointError(
            f"{path}: landmarks have no camera, or lie {quoted(values['depth_m'])} m away, expected a positive number"
        )
    arrays = {name: tensors[LANDMARKS + name].array() for name in _ARRAYS}
    arrays |= {name: arrays[name].astype(np.float32) for name in _HALVED}
    begins, shown = arrays["begins"].astype(np.int64), arrays["shown"]
    if begins[0] != 0 or begins[-1] != len(shown) or (np.diff(begins) < 0).any():
        raise CheckpointError(f"{path}: landmarks.begins does not split the {len(shown)} of landmarks.shown by images")
    if len(shown) and not (shown.min() >= 0 and shown.max() < len(arrays["points"])):
        raise CheckpointError(
            f"{path}: landmarks.shown has {shown.min()} to {shown.max()}, expected 0 to {len(arrays['points']) - 1}"
        )
    view = ViewCamera(camera, float(values["k1"]), float(values["k2"]))
    verification = parse_config(path, "landmarks.verification", Verification, values["verification"])
    return Landmarks(LandmarkMap(stated, view, float(values["depth_m"]), **arrays), verification)
