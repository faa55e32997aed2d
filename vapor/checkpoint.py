"""A trained model as one safetensors file: weights, configuration, scene box, calibration and provenance."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch
from jaxtyping import Int64
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from filtering.density import KernelDensity
from filtering.errors import VaporTrackError, require_within
from filtering.posterior import LikelihoodModel, PoseDensity, PosteriorSamples
from filtering.se3 import Poses
from sequences.atomic import atomic_output
from vapor.baselines import make_regressor
from vapor.network import NetworkConfig, PoseRegressor, SceneBox

FORMAT = "vapor-track model"
VERSION = 5
_OLDER = "4"  # is read as well
_UNSAID = {"shortcut": False}  # what networks of that version are and did not say
MAX_PRIOR_POSES = 2000
# Enough for kernels as wide as a place: log densities change by 0.1.
_PLACE_SAMPLES, _PRIOR_KERNELS = 250, 500
_SHIPPED = Path(__file__).parent / "models"
_NETWORK = "network."
_ROTATION, _TRANSLATION = "prior_poses.rotation", "prior_poses.translation"
_KINDS = {bool: ("true or false", {bool}), int: ("a whole number", {int}), float: ("a number", {int, float})}
_FLOATS = (torch.float16, torch.bfloat16, torch.float32, torch.float64)
_ORTHONORMAL_WITHIN = 1e-3

Config = TypeVar("Config")


class CheckpointError(VaporTrackError):
    """A model file cannot be used."""


@dataclass(frozen=True)
class Calibration:
    """How samples become a density, and the density a likelihood; see `LikelihoodModel` for the formula."""

    bandwidth_translation_m: float = 0.1
    """Kernel width of the posterior samples along each axis, metres."""
    bandwidth_rotation_rad: float = 0.1
    """Kernel width of the posterior samples about each axis, radians."""
    outlier_floor: float = 0.05
    """ε: how much of the likelihood is left when the image says nothing."""
    temper: float = 0.2
    """β: exponent of the likelihood that tells places apart, below 1 as neighbouring images share their errors."""
    saturation: float = 4.0
    """c: log evidence from which on a place counts as possible."""
    preference: float = 0.06
    """γ: share of the log evidence beyond c that counts: which of the possible places the network prefers."""
    place_bandwidth_translation_m: float = 0.4
    """Kernel width along each axis, metres, with which places are told apart."""
    place_bandwidth_rotation_rad: float = 0.3
    """Kernel width about each axis, radians, with which places are told apart."""
    detail_temper: float = 0.2
    """β_d: exponent of the likelihood within a place."""
    prior_floor_quantile: float = 0.5
    """π_min, the least density that is divided by, is this quantile of π at the poses it is made of.
    Where no camera ever was π is almost nothing: a small floor would reward a smeared posterior for lying there."""
    prior_bandwidth_translation_m: float = 0.6
    """Kernel width of π along each axis, metres."""
    prior_bandwidth_rotation_rad: float = 0.6
    """Kernel width of π about each axis, radians."""

    def __post_init__(self) -> None:
        require_within(
            self,
            bandwidth_translation_m=(1e-6, 1e6),
            bandwidth_rotation_rad=(1e-3, 10.0),
            outlier_floor=(1e-9, 0.999999),
            temper=(1e-6, 1.0),
            saturation=(1e-6, 1e6),
            preference=(0.0, 1.0),
            place_bandwidth_translation_m=(1e-6, 1e6),
            place_bandwidth_rotation_rad=(1e-3, 10.0),
            detail_temper=(0.0, 1.0),
            prior_floor_quantile=(0.0, 1.0),
            prior_bandwidth_translation_m=(1e-6, 1e6),
            prior_bandwidth_rotation_rad=(1e-3, 10.0),
        )

    def density(self, samples: Poses) -> KernelDensity:
        """p̂, the kernel density of posterior samples (m,)."""
        return KernelDensity(samples, self.bandwidth_translation_m, self.bandwidth_rotation_rad)

    def likelihood(self, prior_poses: Poses) -> LikelihoodModel:
        """How p̂ becomes a likelihood, π being the kernel density of the poses (n,)."""
        prior_poses = thin_poses(prior_poses, _PRIOR_KERNELS)
        prior = KernelDensity(prior_poses, self.prior_bandwidth_translation_m, self.prior_bandwidth_rotation_rad)
        log_floor = np.quantile(prior.log_density(prior_poses), self.prior_floor_quantile)
        return LikelihoodModel(
            prior,
            self.outlier_floor,
            self.temper,
            float(np.exp(log_floor)),
            self.saturation,
            self.preference,
            self.detail_temper,
        )

    def posterior(
        self, samples: Poses, likelihood: LikelihoodModel, density: PoseDensity | None = None
    ) -> PosteriorSamples:
        """The posterior of an image from its samples (m,), with `likelihood` of the same model.

        `density` is the one that the samples were drawn from, where it is known; without it they become kernels.
        """
        wide = self.place_bandwidth_translation_m, self.place_bandwidth_rotation_rad
        places = KernelDensity(samples[:_PLACE_SAMPLES], *wide)
        return PosteriorSamples(self.density(samples) if density is None else density, likelihood, places)


@dataclass(frozen=True)
class Checkpoint:
    """Everything that `observe` needs.

    Attributes:
        network: Shape of the network.
        box: Box of predicted positions.
        calibration: Of densities and likelihoods.
        prior_poses: A posterior sample of each of n ≤ 2000 training images, batch (n,). Their density is π, the mean of
            the posteriors: where the network puts more than its share whatever it sees, that is divided out.
        state_dict: Parameters and BatchNorm statistics of the `PoseRegressor`, float32 on the CPU.
        training: Where it came from (data names, seed, images seen, validation figures); any JSON.
    """

    network: NetworkConfig
    box: SceneBox
    calibration: Calibration
    prior_poses: Poses
    state_dict: Mapping[str, Tensor]
    training: dict[str, Any] = field(default_factory=dict)

    def build_network(self) -> PoseRegressor:
        """The network with its weights, on the CPU, in evaluation mode."""
        network = make_regressor(self.network, self.box)
        network.load_state_dict(dict(self.state_dict))
        return network.eval()

    def network_sha256(self) -> str:
        """What the posterior samples depend on: a digest of network, box and weights, but not of the calibration."""
        network = {name: value for name, value in asdict(self.network).items() if _UNSAID.get(name) is not value}
        digest = hashlib.sha256(json.dumps([network, asdict(self.box)], sort_keys=True).encode())
        for name in sorted(self.state_dict):
            digest.update(name.encode())
            digest.update(self.state_dict[name].numpy().tobytes())
        return digest.hexdigest()


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
        tensors[_NETWORK + name] = value.to(torch.float16) if smaller else value
    config = {
        "network": asdict(checkpoint.network),
        "box": asdict(checkpoint.box),
        "calibration": asdict(checkpoint.calibration),
        "training": checkpoint.training,
    }
    metadata = {"format": FORMAT, "version": str(VERSION), "config": json.dumps(config, allow_nan=False)}
    with atomic_output(path) as temporary:
        # The library's own writing to a file would leave it readable for its owner only.
        temporary.write_bytes(save({name: value.contiguous() for name, value in tensors.items()}, metadata))


def load_checkpoint(path: Path) -> Checkpoint:
    """Read a model file, strictly.

    Raises:
        CheckpointError: no such file, no safetensors file, another format or version, a configuration with missing,
            surplus or unusable values, tensors that are missing, surplus, misshapen, of another type or not finite, or
            prior poses that are none.
    """
    metadata, tensors = read_safetensors(path)
    found = metadata.get("format")
    if found != FORMAT:
        raise CheckpointError(f"{path}: format is {found!r} in its metadata, expected {FORMAT!r}")
    version = metadata.get("version")
    if version not in (str(VERSION), _OLDER):
        raise CheckpointError(f"{path}: format version is {version!r}, expected '{VERSION}' or '{_OLDER}'")
    config = read_json(path, metadata.get("config"))
    network = config.get("network")
    if version == _OLDER and isinstance(network, dict):
        network = network | _UNSAID
    network = parse_config(path, "network", NetworkConfig, network)
    box = parse_config(path, "box", SceneBox, _with_triples(path, config.get("box")))
    calibration = parse_config(path, "calibration", Calibration, config.get("calibration"))
    training = config.get("training")
    if not isinstance(training, dict):
        raise CheckpointError(f"{path}: training is {type(training).__name__} in its configuration, expected an object")

    with torch.device("meta"):  # names and shapes only, no memory
        expected = make_regressor(network, box).state_dict()
    check_tensors(path, tensors, {_NETWORK + name: value for name, value in expected.items()})
    state = {name: tensors[_NETWORK + name] for name in expected}
    state = {name: value.float() if value.is_floating_point() else value for name, value in state.items()}
    poses = Poses(tensors[_ROTATION].double().numpy(), tensors[_TRANSLATION].double().numpy())
    return Checkpoint(network, box, calibration, poses, state, training)


def find_model(name_or_path: str) -> Path:
    """The file of a model: a path, or the name of a model that ships with the package.

    Raises:
        CheckpointError: neither a file nor a shipped model; lists those that ship.
    """
    path = Path(name_or_path)
    if path.is_file():
        return path
    shipped = _SHIPPED / f"{name_or_path}.safetensors"
    if path.name == name_or_path and shipped.is_file():
        return shipped
    names = ", ".join(sorted(p.stem for p in _SHIPPED.glob("*.safetensors"))) or "none"
    raise CheckpointError(f"{name_or_path}: no such model file, expected one, or a model that ships: {names}")


def read_safetensors(path: Path) -> tuple[dict[str, str], dict[str, Tensor]]:
    """Metadata and tensors of a safetensors file, on the CPU.

    Raises:
        CheckpointError: no such file, or no safetensors file.
    """
    if not path.is_file():
        raise CheckpointError(f"{path}: no such file, expected a safetensors file")
    try:
        with safe_open(path, framework="pt") as file:
            return file.metadata() or {}, {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (OSError, SafetensorError, ValueError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise CheckpointError(f"{path}: cannot be read ({reason}), expected a safetensors file") from error


def read_json(path: Path, text: str | None) -> dict[str, Any]:
    """The JSON object in a file's metadata.

    Raises:
        CheckpointError: absent, or no JSON object.
    """
    try:
        value = json.loads(text or "null")
    except json.JSONDecodeError as error:
        raise CheckpointError(f"{path}: configuration in its metadata is not JSON ({error})") from error
    if not isinstance(value, dict):
        raise CheckpointError(f"{path}: configuration in its metadata is {text!r}, expected a JSON object")
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
            f"{path}: {name} configuration lacks {sorted(expected - found)} and has surplus {sorted(found - expected)},"
            f" expected {sorted(expected)}"
        )
    for f in fields(kind):  # pyright: ignore[reportArgumentType]
        what, kinds = _KINDS.get(type(f.default), ("", None))
        if kinds and type(values[f.name]) not in kinds:
            raise CheckpointError(f"{path}: {name} configuration has {f.name} {values[f.name]!r}, expected {what}")
    try:
        return kind(**values)
    except (VaporTrackError, TypeError) as error:
        raise CheckpointError(f"{path}: {name} configuration: {error}") from error


def check_tensors(path: Path, tensors: Mapping[str, Tensor], network: Mapping[str, Tensor]) -> None:
    """Check that exactly the network's tensors and the prior poses are there: shapes, types, finite, rotations.

    Args:
        path: The file, for messages.
        tensors: What was found.
        network: Tensors of the shapes and types (floating or not) that the network has.
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
    rotation = tensors[_ROTATION].double()
    skew = (rotation.mT @ rotation - torch.eye(3, dtype=torch.float64)).abs().amax(dim=(1, 2))
    wrong = ~((skew <= _ORTHONORMAL_WITHIN) & (torch.linalg.det(rotation) > 0))
    if wrong.any():
        raise CheckpointError(
            f"{path}: tensor {_ROTATION} has {int(wrong.sum())} matrices that are no rotations, the first is number"
            f" {int(wrong.int().argmax())}; expected RᵀR = I within {_ORTHONORMAL_WITHIN} and det R = 1"
        )


def _with_triples(path: Path, box: Any) -> Any:
    """JSON's lists as the tuples that a box has."""
    if not isinstance(box, dict):
        return box
    for name, values in box.items():
        if not (isinstance(values, list) and len(values) == 3 and all(isinstance(v, int | float) for v in values)):
            raise CheckpointError(f"{path}: box configuration has {name} {values!r}, expected three numbers")
    return {name: (float(x), float(y), float(z)) for name, (x, y, z) in box.items()}
