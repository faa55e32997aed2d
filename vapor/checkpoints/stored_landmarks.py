"""Landmarks in a model file: their tensors and settings, and whether those found are usable."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from filtering.errors import quoted
from vapor.checkpoints.stored_config import parse_camera, parse_config
from vapor.checkpoints.stored_tensors import LANDMARKS, Shapes
from vapor.landmarks.features import SIFT_SIZE, SIZE
from vapor.landmarks.landmark_map import LandmarkMap, ViewCamera
from vapor.landmarks.verify import Landmarks, Verification
from vapor.tensor_files import CheckpointError, StoredTensor

_ARRAYS = (
    "points", "descriptors", "rotation", "translation", "begins", "shown", "mean", "axes", "words", "summary_axes",
    "summaries",
)  # fmt: skip
_HALVED = "summary_axes", "summaries"  # stored as float16
_NUMBERS = "depth_m", "k1", "k2"


def landmark_arrays(landmarks: Landmarks) -> dict[str, np.ndarray]:
    """What a model file has of landmarks as tensors."""
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
    """What of `landmark_arrays` a file must have; none if it has none of it."""
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
