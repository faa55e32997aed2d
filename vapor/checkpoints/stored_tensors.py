"""Parts of a model file: tensors -> poses, OOD model and landmarks, checked; and back.

Readers take their tensors out of a mapping, so that surplus ones are left.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import get_type_hints

import numpy as np

from filtering.errors import VaporTrackError, require_within
from filtering.se3 import Poses
from sequences.frame import Camera
from vapor.landmarks.features import SIFT_SIZE, SIZE
from vapor.landmarks.landmark_map import LandmarkMap, ViewCamera
from vapor.landmarks.verify import Landmarks, Verification
from vapor.regressors.ood_model import OodModel
from vapor.tensor_files import FLOATS, CheckpointError, StoredTensor

NETWORK, MEMORY, PRIOR, OOD_MODEL, LANDMARKS = "network.", "memory.", "prior_poses.", "ood_model.", "landmarks."
"""Prefixes of the names of tensors in a model file."""
MEMORY_FIELDS = "keys", "views", "translation", "rotation"
"""The memory of training images, in the order of `Memory`."""
_NO_ARRAYS = "stated", "camera", "depth_m"
_HALVED = "summary_axes", "summaries"  # stored as float16
_ORTHONORMAL_WITHIN = 1e-3


@dataclass(frozen=True)
class LandmarksConfig:
    """Settings of landmarks in a model file, beside their tensors."""

    stated: Camera | None
    camera: Camera
    k1: float
    k2: float
    depth_m: float
    verification: Verification

    def __post_init__(self) -> None:
        require_within(self, k1=(-1e6, 1e6), k2=(-1e6, 1e6), depth_m=(1e-9, 1e9))

    @staticmethod
    def of(landmarks: Landmarks) -> LandmarksConfig:
        """The settings of landmarks."""
        m = landmarks.map
        return LandmarksConfig(m.stated, m.camera.camera, m.camera.k1, m.camera.k2, m.depth_m, landmarks.verification)


def float32(tensor: StoredTensor) -> np.ndarray:
    """A tensor with floating numbers as float32, and whole numbers as they are."""
    return tensor.array().astype(np.float32) if tensor.dtype in FLOATS else tensor.array()


def take_tensor(path: Path, tensors: dict[str, StoredTensor], name: str) -> StoredTensor:
    """Take a tensor out of a file's tensors.

    Raises:
        CheckpointError: absent, empty or with numbers that are not finite.
    """
    if (tensor := tensors.pop(name, None)) is None:
        raise CheckpointError(f"{path}: lacks tensor {name}, expected all tensors of its configuration")
    if 0 in tensor.shape:
        raise CheckpointError(f"{path}: tensor {name} has shape {tensor.shape}, expected no empty tensor")
    if not np.isfinite(tensor.array()).all():
        raise CheckpointError(f"{path}: tensor {name} has values that are not finite")
    return tensor


def refuse_surplus(path: Path, tensors: dict[str, StoredTensor]) -> None:
    """Raise a CheckpointError where tensors are left."""
    if tensors:
        raise CheckpointError(
            f"{path}: has surplus tensor {min(tensors)} ({len(tensors)} such), expected those of its configuration"
        )


def take_poses(path: Path, tensors: dict[str, StoredTensor], prefix: str) -> Poses:
    """Poses (n,) from the tensors `rotation` and `translation` after a prefix.

    Raises:
        CheckpointError: absent, of other shapes, or not rigid.
    """
    rotation, translation = (
        take_tensor(path, tensors, prefix + name).array().astype(np.float64) for name in ("rotation", "translation")
    )
    if (rotation.shape, translation.shape) != ((len(translation), 3, 3), (len(translation), 3)):
        raise CheckpointError(
            f"{path}: {prefix}rotation and {prefix}translation have shapes {rotation.shape} and {translation.shape},"
            " expected (n, 3, 3) and (n, 3)"
        )
    _require_rotations(path, f"{prefix}rotation", rotation)
    return Poses(rotation, translation)


def _require_rotations(path: Path, name: str, rotation: np.ndarray) -> None:
    rotation = rotation.astype(np.float64)
    with np.errstate(all="ignore"):  # of huge numbers
        skew = np.abs(np.swapaxes(rotation, 1, 2) @ rotation - np.eye(3)).max(axis=(1, 2))
        wrong = ~((skew <= _ORTHONORMAL_WITHIN) & (np.linalg.det(rotation) > 0))
    if wrong.any():
        raise CheckpointError(
            f"{path}: tensor {name} has {int(wrong.sum())} matrices that are not rotations, the first is number"
            f" {int(wrong.argmax())}; expected RᵀR = I within {_ORTHONORMAL_WITHIN} and det R = 1"
        )


def _take_arrays(
    path: Path, tensors: dict[str, StoredTensor], prefix: str, kind: type, sizes: dict[str, int]
) -> dict[str, np.ndarray]:
    """Arrays of a dataclass' fields, checked against their annotations, in which equal names of axes are equal sizes.

    `sizes` has the axes of known size.
    """
    arrays = {}
    for name, hint in get_type_hints(kind).items():
        if name in _NO_ARRAYS:
            continue
        array = arrays[name] = float32(take_tensor(path, tensors, prefix + name))
        axes, dtype = ((), "float32") if hint is float else (hint.dim_str.split(), hint.dtypes[0])
        shape = tuple(sizes.setdefault(axis, size) for axis, size in zip(axes, array.shape, strict=False))
        if array.shape != shape or len(axes) != len(shape) or array.dtype != dtype:
            wanted = ", ".join(str(sizes.get(axis, axis)) for axis in axes)
            raise CheckpointError(
                f"{path}: tensor {prefix}{name} has shape {array.shape} and type {array.dtype}, expected ({wanted})"
                f" and {dtype}"
            )
    return arrays


def ood_model_arrays(ood_model: OodModel) -> dict[str, np.ndarray]:
    """The OOD model as tensors of a model file: matrices as float16, the rest as float32."""
    found = {each.name: np.asarray(getattr(ood_model, each.name)) for each in fields(OodModel)}
    return {OOD_MODEL + name: v.astype(np.float16 if v.ndim == 2 else np.float32) for name, v in found.items()}


def take_ood_model(path: Path, tensors: dict[str, StoredTensor], size: int) -> OodModel | None:
    """The OOD model of a network that describes images by `size` numbers; None where a file has none.

    Raises:
        CheckpointError: missing tensors, other shapes, or values that cannot be used.
    """
    if not any(name.startswith(OOD_MODEL) for name in tensors):
        return None
    found = _take_arrays(path, tensors, OOD_MODEL, OodModel, {"d": size})
    try:
        own_distance, threshold = (float(found.pop(name)) for name in ("own_distance", "threshold"))
        return OodModel(**found, own_distance=own_distance, threshold=threshold)
    except VaporTrackError as error:
        raise CheckpointError(f"{path}: {error}") from error


def landmark_arrays(landmarks: Landmarks) -> dict[str, np.ndarray]:
    """Landmarks as tensors of a model file."""
    names = [each.name for each in fields(LandmarkMap) if each.name not in _NO_ARRAYS]
    found = {name: np.asarray(getattr(landmarks.map, name)) for name in names}
    return {LANDMARKS + name: v.astype(np.float16) if name in _HALVED else v for name, v in found.items()}


def take_landmarks(path: Path, tensors: dict[str, StoredTensor], config: LandmarksConfig) -> Landmarks:
    """Landmarks of these settings.

    Raises:
        CheckpointError: missing tensors, other shapes, values that cannot be used, or points that are not there.
    """
    arrays = _take_arrays(path, tensors, LANDMARKS, LandmarkMap, {"3": 3, "q": SIFT_SIZE})
    begins, shown, words = arrays["begins"], arrays["shown"], arrays["words"]
    if begins[0] != 0 or begins[-1] != len(shown) or (np.diff(begins.astype(np.int64)) < 0).any():
        raise CheckpointError(f"{path}: landmarks.begins does not split the {len(shown)} of landmarks.shown by images")
    if shown.min() < 0 or shown.max() >= len(arrays["points"]):
        raise CheckpointError(
            f"{path}: landmarks.shown has {shown.min()} to {shown.max()}, expected 0 to {len(arrays['points']) - 1}"
        )
    if len(begins) != len(arrays["rotation"]) + 1 or len(arrays["summary_axes"]) != words.size or words.shape[1] > SIZE:
        raise CheckpointError(
            f"{path}: landmarks.begins, words and summary_axes have shapes {begins.shape}, {words.shape} and"
            f" {arrays['summary_axes'].shape}, expected (n + 1,), (w, d) and (w d, k) with d up to {SIZE}"
        )
    _require_rotations(path, f"{LANDMARKS}rotation", arrays["rotation"])
    view = ViewCamera(config.camera, config.k1, config.k2)
    return Landmarks(LandmarkMap(config.stated, view, config.depth_m, **arrays), config.verification)
