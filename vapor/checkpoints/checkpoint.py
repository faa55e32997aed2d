"""A trained model as one safetensors file: weights, configuration, scene box, calibration and provenance."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch
from jaxtyping import Int64
from torch import Tensor

from filtering.density import KernelDensity
from filtering.error_model import ErrorModel
from filtering.errors import VaporTrackError, quoted, require_within
from filtering.se3 import Poses
from sequences.files.structured import parse_json
from sequences.frame import Camera
from sequences.odometry_fit.result import OdometryFit
from vapor.checkpoints.scene_scale import default_errors
from vapor.regressors.base import PoseRegressor
from vapor.regressors.familiarity import Familiarity, description_size
from vapor.regressors.memory import Memory
from vapor.regressors.network_config import NetworkConfig
from vapor.regressors.registry import make_regressor
from vapor.regressors.scene_box import SceneBox
from vapor.tensor_files import (
    CHECKSUM,
    SHIPPED,
    CheckpointError,
    format_of,
    read_safetensors,
    write_safetensors,
)

FORMAT = "vapor-track model"
VERSION = 8
_BEFORE_MISTAKES = "7"  # mistakes about the place were taken to last as long as errors within it
_BEFORE_GROWTH = "6"  # images of all scores were taken to err alike
_ALIKE = {"mistaken_lengths": 1.0}  # what error models of those versions are and did not say
_EVEN = {"unfamiliar_power": 0.0, "unfamiliar_score": 0.5, **_ALIKE}
_BEFORE_ERRORS = ("4", "5")  # their calibrations are of another filter: all but the kernel widths is left out
_BEFORE_SHORTCUT = "4"
_UNSAID = {"shortcut": False}  # what networks of that version are and did not say
MAX_PRIOR_POSES = 2000
NETWORK = "network."
"""What the names of the network's tensors begin with in a file."""
_FAMILIARITY, _MEMORY = "familiarity.", "memory."
_MEMORY_HALF = "keys", "views"  # poses are exact
_ROTATION, _TRANSLATION = "prior_poses.rotation", "prior_poses.translation"
_SIX = {"floor", "typical_std"}
_KINDS = {bool: ("true or false", {bool}), int: ("a whole number", {int}), float: ("a number", {int, float})}
_FLOATS = (torch.float16, torch.bfloat16, torch.float32, torch.float64)
_ORTHONORMAL_WITHIN = 1e-3

Config = TypeVar("Config")


@dataclass(frozen=True)
class Calibration:
    """How wrong a model's posteriors are, and the odometry of its scene; `vapor-track calibrate` fits it."""

    bandwidth_translation_m: float = 0.1
    """Kernel width of the posterior samples along each axis, metres: of their density, in figures."""
    bandwidth_rotation_rad: float = 0.1
    """Kernel width of the posterior samples about each axis, radians."""
    errors: ErrorModel = field(default_factory=ErrorModel)
    """How the places among the samples err."""
    odometry: OdometryFit | None = None
    """How wrong odometry was on the data; None where none was at hand."""

    def __post_init__(self) -> None:
        require_within(self, bandwidth_translation_m=(1e-9, 1e9), bandwidth_rotation_rad=(1e-3, 10.0))

    def density(self, samples: Poses) -> KernelDensity:
        """p̂, the kernel density of posterior samples (m,)."""
        return KernelDensity(samples, self.bandwidth_translation_m, self.bandwidth_rotation_rad)


@dataclass(frozen=True)
class Checkpoint:
    """Everything that `observe` needs.

    Attributes:
        network: Shape of the network.
        box: Box of predicted positions.
        calibration: How wrong its posteriors are.
        prior_poses: A posterior sample of each of n ≤ 2000 training images, batch (n,): they outline the scene.
        state_dict: Parameters and BatchNorm statistics of the `PoseRegressor`, float32 on the CPU.
        training: Where it came from (data names, seed, images seen, validation figures); any JSON.
        familiarity: What training images look like to the network; None where that was never looked at.
        camera: What took the training images, undistorted; None where unknown.
        memory: The training images as a retrieval regressor remembers them; None with any other.
        notices: What a person should know of the file that it was read from.
    """

    network: NetworkConfig
    box: SceneBox
    calibration: Calibration
    prior_poses: Poses
    state_dict: Mapping[str, Tensor]
    training: dict[str, Any] = field(default_factory=dict)
    familiarity: Familiarity | None = None
    camera: Camera | None = None
    memory: Memory | None = None
    notices: tuple[str, ...] = ()

    def build_network(self) -> PoseRegressor:
        """The network with its weights, on the CPU, in evaluation mode."""
        network = make_regressor(self.network, self.box)
        network.load_state_dict(dict(self.state_dict))
        network.memory = self.memory
        return network.eval()

    def network_sha256(self) -> str:
        """What the posterior samples depend on: a digest of network, box and weights, but not of the calibration."""
        digest = hashlib.sha256(json.dumps([asdict(self.network), asdict(self.box)], sort_keys=True).encode())
        for name in sorted(self.state_dict):
            digest.update(name.encode())
            digest.update(self.state_dict[name].numpy().tobytes())
        for value in self.memory.tensors().values() if self.memory else ():
            digest.update(value.numpy().tobytes())
        return digest.hexdigest()

    def seen_sha256(self) -> str:
        """What the network says of an image depends on it: samples, how unlike training images it is, what it sees."""
        seen = hashlib.sha256(self.network_sha256().encode())
        for name, value in vars(self.familiarity).items() if self.familiarity else ():
            seen.update(name.encode() + np.asarray(value).tobytes())
        if self.camera is not None:
            seen.update(json.dumps(asdict(self.camera)).encode())
        return seen.hexdigest()


def thin_poses(poses: Poses, limit: int = MAX_PRIOR_POSES) -> Poses:
    """At most `limit` of the poses (n,), evenly spaced in their order."""
    return poses if len(poses) <= limit else poses[spaced(len(poses), limit)]


def spaced(count: int, limit: int) -> Int64[np.ndarray, " n"]:
    """Indices of min(count, limit) of `count` things, evenly spaced in their order."""
    return np.linspace(0, count - 1, min(count, limit)).round().astype(np.int64)


def save_checkpoint(path: Path, checkpoint: Checkpoint, *, half: bool = False) -> None:
    """Write a model file, complete or not at all.

    Args:
        path: A file name, usually *.safetensors.
        checkpoint: What to write; more than 2000 prior poses are thinned evenly.
        half: Store weight matrices as float16, for half the size; biases and BatchNorm stay float32.
    """
    poses = thin_poses(checkpoint.prior_poses)
    tensors = {_ROTATION: torch.from_numpy(poses.rotation), _TRANSLATION: torch.from_numpy(poses.translation)}
    for name, value in checkpoint.state_dict.items():
        smaller = half and value.is_floating_point() and value.ndim > 1
        tensors[NETWORK + name] = value.to(torch.float16) if smaller else value
    if checkpoint.familiarity is not None:
        tensors |= _familiarity_tensors(checkpoint.familiarity)
    for name, value in checkpoint.memory.tensors().items() if checkpoint.memory else ():
        tensors[_MEMORY + name] = value.to(torch.float16) if half and name in _MEMORY_HALF else value
    config = {
        "network": asdict(checkpoint.network),
        "box": asdict(checkpoint.box),
        "calibration": asdict(checkpoint.calibration),
        "training": checkpoint.training,
        "camera": None if checkpoint.camera is None else asdict(checkpoint.camera),
    }
    metadata = {"format": FORMAT, "version": str(VERSION), "config": json.dumps(config, allow_nan=False)}
    write_safetensors(path, tensors, metadata)


def load_checkpoint(path: Path) -> Checkpoint:
    """Read a model file, strictly.

    Of files of format 4 and 5 the calibration is that of an earlier filter: its kernel widths are taken, and for the
    rest the errors of a model that was not calibrated (`default_errors`). Calibrating such a model anew makes it whole.
    In files of format 6 errors do not grow with how unfamiliar an image is; in those and in files of format 7 mistakes
    about the place last as long as errors within it.

    Raises:
        CheckpointError: no such file, no safetensors file, a damaged one, another format or version, a configuration
            with missing, surplus or unusable values, tensors that are missing, surplus, misshapen, of another type or
            not finite, or prior poses that are none.
    """
    metadata, tensors = read_safetensors(path)
    found = metadata.get("format")
    if found != FORMAT:
        raise CheckpointError(f"{path}: format is {quoted(found)} in its metadata, expected {FORMAT!r}")
    version = metadata.get("version")
    if version not in (str(VERSION), _BEFORE_MISTAKES, _BEFORE_GROWTH, *_BEFORE_ERRORS):
        older = " or ".join(f"'{number}'" for number in _BEFORE_ERRORS)
        raise CheckpointError(
            f"{path}: format version is {version!r}, expected '{VERSION}', '{_BEFORE_MISTAKES}' or '{_BEFORE_GROWTH}',"
            f" or {older} of which network and scene are taken; train the model anew"
        )
    config = parse_metadata(path, metadata.get("config"))
    network = config.get("network")
    if version == _BEFORE_SHORTCUT and isinstance(network, dict):
        network = network | _UNSAID
    network = parse_config(path, "network", NetworkConfig, network)
    box = parse_config(path, "box", SceneBox, _with_triples(path, config.get("box")))
    training = config.get("training")
    if not isinstance(training, dict):
        raise CheckpointError(f"{path}: training is {type(training).__name__} in its configuration, expected an object")

    with torch.device("meta"):  # names and shapes only, no memory
        regressor = make_regressor(network, box)
        expected = regressor.state_dict()
        known = _familiarity_like(tensors, description_size(regressor)) | _memory_like(tensors, regressor)
    check_tensors(path, tensors, {NETWORK + name: value for name, value in expected.items()} | known)
    state = {name: tensors[NETWORK + name] for name in expected}
    state = {name: value.float() if value.is_floating_point() else value for name, value in state.items()}
    poses = Poses(tensors[_ROTATION].double().numpy(), tensors[_TRANSLATION].double().numpy())
    if version in _BEFORE_ERRORS:
        parse = partial(_former_calibration, prior_poses=poses)
    else:
        parse = partial(_calibration, unsaid={_BEFORE_MISTAKES: _ALIKE, _BEFORE_GROWTH: _EVEN}.get(version, {}))
    calibration = parse(path, config.get("calibration"))
    familiarity = _familiarity(path, tensors) if any(name.startswith(_FAMILIARITY) for name in known) else None
    camera = _camera(path, config.get("camera"))
    memory = _memory(path, tensors) if regressor.recalling else None
    unchecked = f"{path.name} was written before model files had checksums: whether it is damaged cannot be told"
    notices = () if CHECKSUM in metadata else (unchecked,)
    return Checkpoint(network, box, calibration, poses, state, training, familiarity, camera, memory, notices)


def _camera(path: Path, values: Any) -> Camera | None:
    """From JSON; files written before cameras were stored say nothing of one."""
    if values is None:
        return None
    for name, value in values.items() if isinstance(values, dict) else ():
        if type(value) not in ((int,) if name in ("width", "height") else (int, float)):
            raise CheckpointError(f"{path}: camera configuration has {name} {quoted(value)}, expected a number")
    return parse_config(path, "camera", Camera, values)


def _calibration(path: Path, values: Any, *, unsaid: Mapping[str, float]) -> Calibration:
    """From JSON, every field of it and of what it holds given, and no other; but for what error models left unsaid."""
    if not isinstance(values, dict) or "errors" not in values:
        return parse_config(path, "calibration", Calibration, values)  # which says what is wrong
    errors = values["errors"]
    if isinstance(errors, dict):
        for name in _SIX & errors.keys():
            found = errors[name]
            if not (isinstance(found, list) and len(found) == 6 and all(type(v) in (int, float) for v in found)):
                raise CheckpointError(
                    f"{path}: calibration.errors configuration has {name} {quoted(found)}, expected six numbers"
                )
        errors = errors | {name: tuple(map(float, errors[name])) for name in _SIX & errors.keys()} | dict(unsaid)
    odometry = values.get("odometry")
    if odometry is not None:
        if not isinstance(odometry, dict):
            raise CheckpointError(f"{path}: calibration.odometry is {quoted(odometry)}, expected an object or null")
        try:
            odometry = OdometryFit.from_dict(odometry)
        except VaporTrackError as error:
            raise CheckpointError(f"{path}: calibration.odometry configuration: {error}") from error
    held = {"errors": parse_config(path, "calibration.errors", ErrorModel, errors)}
    held |= {"odometry": odometry} if "odometry" in values else {}
    return parse_config(path, "calibration", Calibration, values | held)


def _former_calibration(path: Path, values: Any, *, prior_poses: Poses) -> Calibration:
    """From JSON of format 4 or 5: the kernel widths, with errors in proportion to the scene."""
    names = ("bandwidth_translation_m", "bandwidth_rotation_rad")
    widths = {name: values[name] for name in names if name in values} if isinstance(values, dict) else {}
    errors = default_errors(prior_poses)
    return parse_config(path, "calibration", Calibration, widths | {"errors": errors, "odometry": None})


def _familiarity_tensors(familiarity: Familiarity) -> dict[str, Tensor]:
    found = {name: torch.as_tensor(value) for name, value in vars(familiarity).items()}
    return {
        _FAMILIARITY + name: value.to(torch.float16 if value.ndim == 2 else torch.float32)
        for name, value in found.items()
    }


def _familiarity_like(tensors: Mapping[str, Tensor], size: int) -> dict[str, Tensor]:
    """Tensors of the shapes that they have of a network whose descriptions have this size; none if the file has none.

    How many exemplars and axes there are is taken from the exemplars.
    """
    if not any(name.startswith(_FAMILIARITY) for name in tensors):
        return {}
    exemplars = tensors.get(_FAMILIARITY + "exemplars")
    shape = exemplars.shape if exemplars is not None and exemplars.ndim == 2 else (1, 1)
    count, axes = (max(1, number) for number in shape)
    shapes = {
        "centre": (size,), "scale": (size,), "axes": (size, axes), "stretch": (axes,), "exemplars": (count, axes),
        "own_distance": (), "threshold": (),
    }  # fmt: skip
    return {_FAMILIARITY + name: torch.empty(shape) for name, shape in shapes.items()}


def _memory_like(tensors: Mapping[str, Tensor], regressor: PoseRegressor) -> dict[str, Tensor]:
    """Tensors of the shapes that a memory has, of as many images as there are keys; none where none is needed."""
    recalling = regressor.recalling
    if recalling is None:
        return {}
    keys = tensors.get(_MEMORY + "keys")
    count = max(1, len(keys)) if keys is not None and keys.ndim == 2 else 1
    return {_MEMORY + name: torch.empty(count, *shape) for name, shape in recalling.memory_shapes().items()}


def _memory(path: Path, tensors: Mapping[str, Tensor]) -> Memory:
    """From tensors that were checked."""
    memory = Memory(**{field.name: tensors[_MEMORY + field.name].float() for field in fields(Memory)})
    _require_rotations(path, _MEMORY + "rotation", memory.rotation)
    return memory


def _familiarity(path: Path, tensors: Mapping[str, Tensor]) -> Familiarity:
    """From tensors that were checked."""
    found = {name: tensors[_FAMILIARITY + name].float() for name in (f.name for f in fields(Familiarity))}
    try:
        numbers = {name: float(found.pop(name)) for name in ("own_distance", "threshold")}
        return Familiarity(**{name: value.numpy() for name, value in found.items()}, **numbers)  # pyright: ignore[reportArgumentType]
    except VaporTrackError as error:
        raise CheckpointError(f"{path}: {error}") from error


def find_model(name_or_path: str) -> Path:
    """The file of a model: a path, or the name of a model that ships with the package.

    Raises:
        CheckpointError: neither a file nor a shipped model; lists those that ship.
    """
    path = Path(name_or_path)
    if path.is_file():
        return path
    shipped = SHIPPED / f"{name_or_path}.safetensors"
    if path.name == name_or_path and shipped.is_file():
        return shipped
    names = ", ".join(sorted(p.stem for p in SHIPPED.glob("*.safetensors"))) or "none"
    raise CheckpointError(f"{name_or_path}: no such model file, expected one, or a model that ships: {names}")


def is_model(path: Path) -> bool:
    """Whether a file is a model of any version of this package, by what it says of itself."""
    return format_of(path) == FORMAT


def parse_metadata(path: Path, text: str | None) -> dict[str, Any]:
    """The JSON object in a file's metadata.

    Raises:
        CheckpointError: absent, or no JSON object.
    """
    try:
        value = parse_json(text or "null", f"{path}: configuration in its metadata")
    except VaporTrackError as error:
        raise CheckpointError(str(error)) from error
    if not isinstance(value, dict):
        raise CheckpointError(f"{path}: configuration in its metadata is {quoted(value)}, expected a JSON object")
    return value


def parse_config(path: Path, name: str, kind: type[Config], values: Any) -> Config:
    """A configuration dataclass from JSON, every field given and no other.

    Raises:
        CheckpointError: missing or surplus fields, or values that the dataclass refuses.
    """
    expected = {f.name for f in fields(kind)}  # pyright: ignore[reportArgumentType]
    found = set(values) if isinstance(values, dict) else set()
    if found != expected:
        raise CheckpointError(
            f"{path}: {name} configuration lacks {quoted(sorted(expected - found))} and has surplus"
            f" {quoted(sorted(found - expected))}, expected {', '.join(sorted(expected))}"
        )
    for f in fields(kind):  # pyright: ignore[reportArgumentType]
        what, kinds = _KINDS.get(type(f.default), ("", None))
        if kinds and type(values[f.name]) not in kinds:
            raise CheckpointError(
                f"{path}: {name} configuration has {f.name} {quoted(values[f.name])}, expected {what}"
            )
    try:
        return kind(**values)
    except (VaporTrackError, TypeError) as error:
        raise CheckpointError(f"{path}: {name} configuration: {error}") from error


def check_tensors(path: Path, tensors: Mapping[str, Tensor], network: Mapping[str, Tensor]) -> None:
    """Check that exactly the expected tensors and the prior poses are there: shapes, types, finite, rotations.

    Args:
        path: The file, for messages.
        tensors: What was found.
        network: Tensors of the shapes and types (floating or not) that the network has, and what is familiar to it.
    """
    expected = network.keys() | {_ROTATION, _TRANSLATION}
    for what, names in (("lacks", expected - tensors.keys()), ("has surplus", tensors.keys() - expected)):
        if names:
            raise CheckpointError(
                f"{path}: {what} tensor {min(names)} ({len(names)} such), expected exactly the {len(expected)} tensors"
                " of its configuration"
            )
    count = tensors[_TRANSLATION].shape[0] if tensors[_TRANSLATION].ndim else 0
    if count == 0:
        raise CheckpointError(f"{path}: tensor {_TRANSLATION} is empty, expected at least one training pose")
    poses = {_ROTATION: torch.empty(count, 3, 3), _TRANSLATION: torch.empty(count, 3)}
    for name, like in {**network, **poses}.items():
        found = tensors[name]
        if found.shape != like.shape:
            raise CheckpointError(f"{path}: tensor {name} has shape {tuple(found.shape)}, expected {tuple(like.shape)}")
        kinds = _FLOATS if like.is_floating_point() else (like.dtype,)
        if found.dtype not in kinds:
            raise CheckpointError(f"{path}: tensor {name} is of {found.dtype}, expected {' or '.join(map(str, kinds))}")
        if not torch.isfinite(found).all():
            raise CheckpointError(f"{path}: tensor {name} has values that are not finite")
    _require_rotations(path, _ROTATION, tensors[_ROTATION])


def _require_rotations(path: Path, name: str, matrices: Tensor) -> None:
    rotation = matrices.double()
    skew = (rotation.mT @ rotation - torch.eye(3, dtype=torch.float64)).abs().amax(dim=(1, 2))
    wrong = ~((skew <= _ORTHONORMAL_WITHIN) & (torch.linalg.det(rotation) > 0))
    if wrong.any():
        raise CheckpointError(
            f"{path}: tensor {name} has {int(wrong.sum())} matrices that are no rotations, the first is number"
            f" {int(wrong.int().argmax())}; expected RᵀR = I within {_ORTHONORMAL_WITHIN} and det R = 1"
        )


def _with_triples(path: Path, box: Any) -> Any:
    """JSON's lists as the tuples that a box has."""
    if not isinstance(box, dict):
        return box
    for name, values in box.items():
        if not (isinstance(values, list) and len(values) == 3 and all(isinstance(v, int | float) for v in values)):
            raise CheckpointError(f"{path}: box configuration has {name} {quoted(values)}, expected three numbers")
    return {name: (float(x), float(y), float(z)) for name, (x, y, z) in box.items()}
