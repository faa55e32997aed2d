"""State of a training: its start, and the file beside the output from which an interrupted training resumes exactly."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from time import perf_counter
from typing import Any

import torch
from torch import Tensor, nn

from filtering.se3 import Poses
from vapor.checkpoints.checkpoint import Checkpoint
from vapor.checkpoints.file_format import load_checkpoint
from vapor.checkpoints.stored_config import parse_config, parse_metadata
from vapor.engines.engine import resolve_device
from vapor.evaluation.validation import Validation
from vapor.regressors.backbones import load_pretrained
from vapor.regressors.base import PoseRegressor
from vapor.regressors.network_config import make_regressor
from vapor.regressors.scene_box import SceneBox
from vapor.storage import published
from vapor.tensor_files import CheckpointError, format_of, read_safetensors, write_safetensors
from vapor.training.config import TrainConfig
from vapor.training.memory import TrainingFeatures
from vapor.training.processes import from_first, make_learner, num_processes
from vapor.training_data.training_set import TrainingError

FORMAT = "vapor-track training state"
VERSION = 2
_MOMENTS = {"step", "exp_avg", "exp_avg_sq"}  # AdamW's, of a parameter
_AGAIN = "remove the file, or train with --no-resume, to start again"
_SELDOM = 50.0  # least time from one saving to the next, in durations of the last saving


@dataclass
class TrainingState:
    """A training between two epochs. It has no random generator: an epoch's draws follow from seed and number.

    Attributes:
        network: The network being trained.
        average: The exponential moving average of its weights, which is evaluated and becomes the model.
        learner: Gives the network's loss, from `make_learner`.
        optimizer: AdamW, with its moments.
        epochs: Number of epochs before the model is evaluated.
        epoch: Number of finished epochs; more than `epochs` while held-out images are learned from, too.
        seconds: Duration of the finished epochs, without evaluation.
        history: Figures of the evaluated epochs.
        best: Weights of the best epoch so far, on the CPU.
        features: Features of the training images, for a regressor that recalls images; not stored.
    """

    network: PoseRegressor
    average: PoseRegressor
    learner: nn.Module
    optimizer: torch.optim.Optimizer
    epochs: int = 0
    epoch: int = 0
    seconds: float = 0.0
    history: list[Validation] = field(default_factory=list)
    best: dict[str, Tensor] = field(default_factory=dict)
    features: TrainingFeatures | None = None


def state_path(output: Path) -> Path:
    """Path of the state of a training whose model will be `output`."""
    return output.with_suffix(".training.safetensors")


def is_training_state(path: Path) -> bool:
    """Whether a file is a training's state."""
    return format_of(path) == FORMAT


def save_state(path: Path, state: TrainingState, identity: Mapping[str, Any]) -> None:
    """Write the state, complete or not at all, with the JSON (configuration, data) that identifies the training."""
    tensors = {f"network.{k}": v for k, v in state.network.state_dict().items()}
    tensors |= {f"average.{k}": v for k, v in state.average.state_dict().items()}
    tensors |= {f"best.{k}": v for k, v in state.best.items()}
    for index, moments in state.optimizer.state_dict()["state"].items():
        tensors |= {f"optimizer.{index}.{k}": v for k, v in moments.items()}
    config = {
        "identity": json.loads(json.dumps(identity)),
        "epochs": state.epochs,
        "epoch": state.epoch,
        "seconds": state.seconds,
        "history": [asdict(validation) for validation in state.history],
    }
    write_safetensors(path, tensors, {"format": FORMAT, "version": str(VERSION), "config": json.dumps(config)})
    published(path)


def load_state(path: Path, state: TrainingState, identity: Mapping[str, Any]) -> None:
    """Fill a fresh state from a file, in place.

    Raises:
        CheckpointError: no training state, or a damaged one, of another version or of another training.
    """
    try:
        metadata, tensors = read_safetensors(path)
    except CheckpointError as error:
        raise CheckpointError(f"{error}; {_AGAIN}") from error
    found = metadata.get("format"), metadata.get("version")
    if found != (FORMAT, str(VERSION)):
        raise CheckpointError(f"{path}: format and version are {found}, expected {(FORMAT, str(VERSION))}")
    config = parse_metadata(path, metadata.get("config"))
    expected = json.loads(json.dumps(identity))
    other = config.get("identity")
    if other != expected:
        differs = [k for k in expected if not isinstance(other, dict) or other.get(k) != expected[k]]
        raise CheckpointError(
            f"{path}: interrupted training differs in {', '.join(differs) or 'its configuration'}, expected the same"
            f" configuration and data; {_AGAIN}"
        )
    groups: dict[str, dict[str, Tensor]] = defaultdict(dict)
    for name, value in tensors.items():
        group, _, rest = name.partition(".")
        groups[group][rest] = value
    try:
        state.network.load_state_dict(groups["network"])
        state.average.load_state_dict(groups["average"])
        moments = _moments(groups["optimizer"], state.optimizer)
        state.optimizer.load_state_dict({**state.optimizer.state_dict(), "state": moments})
        if groups["best"]:
            deepcopy(state.average).load_state_dict(groups["best"])
        state.best = groups["best"]
        state.epochs, state.epoch = int(config["epochs"]), int(config["epoch"])
        state.seconds = float(config["seconds"])
        state.history = [parse_config(path, "history", Validation, entry) for entry in config["history"]]
    except (RuntimeError, ValueError, TypeError, LookupError) as error:
        raise CheckpointError(
            f"{path}: {' '.join(str(error).split())}, expected a training's state; {_AGAIN}"
        ) from error


def _moments(tensors: Mapping[str, Tensor], optimizer: torch.optim.Optimizer) -> dict[int, dict[str, Tensor]]:
    """AdamW's moments by the index of their parameter, in the parameter's memory layout.

    The fused AdamW goes through parameter and moments by address: a channels-last parameter with contiguous moments
    would silently be updated with the moments of other elements.
    """
    parameters = [p for group in optimizer.param_groups for p in group["params"]]
    moments: dict[int, dict[str, Tensor]] = {}
    for name, value in tensors.items():
        index, _, key = name.partition(".")
        alike = value if key == "step" else torch.empty_like(parameters[int(index)]).copy_(value)
        moments.setdefault(int(index), {})[key] = alike.detach()
    if any(each.keys() != _MOMENTS for each in moments.values()):
        raise ValueError(f"the optimizer has moments other than {', '.join(sorted(_MOMENTS))}")
    return moments


def initial_model(config: TrainConfig) -> Checkpoint | None:
    """The model all of whose weights are the start, if one is configured.

    Raises:
        TrainingError: the model's network has another shape.
        CheckpointError: the model cannot be read.
    """
    if config.initial_model is None:
        return None
    initial = load_checkpoint(config.initial_model)
    wanted = config.network
    sizes = {name: getattr(wanted, name) for name in ("image_width", "image_height", "shortest_edge")}
    found = replace(initial.network, **sizes)  # convolutions fit images of any size
    pairs = ((name, getattr(found, name), value) for name, value in asdict(wanted).items())
    if other := [f"{name} {has!r} (expected {value!r})" for name, has, value in pairs if has != value]:
        raise TrainingError(f"{config.initial_model}: its network has {', '.join(other)} as configured")
    return initial


def start(config: TrainConfig, box: SceneBox, poses: Poses, initial: Checkpoint | None) -> TrainingState:
    """The state before the first step, on the configured device.

    Args:
        config: Configuration of the training.
        box: Box of the camera positions.
        poses: world_from_camera of the training images, (n,), by which some regressors are initialised.
        initial: From `initial_model`.

    Raises:
        VaporTrackError: weights of the backbone or the device are missing.
    """
    device = resolve_device(config.device)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(config.seed)
        network = make_regressor(config.network, box)
        average = make_regressor(config.network, box)
    packaged = config.pretrained and config.network.backbone == "efficientnet-lite0"
    if config.pretrained_weights is not None or packaged:
        load_pretrained(network, config.pretrained_weights)
    network.initialise(poses, log_variance=config.initial_log_variance)
    if initial is not None:
        network.load_state_dict(dict(initial.state_dict))
    average.load_state_dict(network.state_dict())
    network, average = (
        n.to(device).to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
        for n in (network, average)
    )
    learner = make_learner(network)
    optimizer = torch.optim.AdamW(parameter_groups(network, config), lr=config.learning_rate, fused=True)
    return TrainingState(network, average, learner, optimizer)


def parameter_groups(network: PoseRegressor, config: TrainConfig) -> list[dict[str, Any]]:
    """Matrices, which decay, and biases and BatchNorm, which do not."""
    return [
        {"params": [p for p in network.parameters() if p.ndim > 1], "weight_decay": config.weight_decay},
        {"params": [p for p in network.parameters() if p.ndim <= 1], "weight_decay": 0.0},
    ]


class Saving:
    """Saves a training's state after epochs; not after each where epochs are short, which would slow the training."""

    def __init__(self, path: Path, identity: Mapping[str, Any]) -> None:
        self._path, self._identity = path, identity
        self._next_s = 0.0

    def resume(self, state: TrainingState) -> None:
        """Fill a fresh state from the file, if there is one."""
        if self._path.exists():
            load_state(self._path, state, self._identity)

    def save(self, state: TrainingState, *, last: bool = False) -> None:
        """Write the state between two epochs, unless it was written a short time ago; with `last` in any case."""
        begin_s = perf_counter()
        if last or begin_s >= self._next_s:
            save_state(self._path, state, self._identity)
            end_s = perf_counter()
            self._next_s = end_s + _SELDOM * (end_s - begin_s)

    def remove(self) -> None:
        """Remove the file of a training that is finished."""
        self._path.unlink(missing_ok=True)


def share_state(state: TrainingState) -> None:
    """Give the first process' weights, moments and epochs to all others, in place."""
    if num_processes() == 1:
        return
    parts = state.network, state.average, state.optimizer
    values = from_first([_on_cpu(part.state_dict()) for part in parts])
    for part, value in zip(parts, values, strict=True):
        part.load_state_dict(value)
    state.epochs, state.epoch, state.seconds = from_first((state.epochs, state.epoch, state.seconds))


def _on_cpu(values: Any) -> Any:
    """A state's tensors on the CPU, in their memory layout: another process has another GPU."""
    if isinstance(values, torch.Tensor):
        return values.detach().cpu()
    if isinstance(values, dict):
        return {name: _on_cpu(value) for name, value in values.items()}
    return [_on_cpu(value) for value in values] if isinstance(values, list) else values
