"""What an interrupted training needs to go on as if nothing had happened: one safetensors file beside the output."""

from __future__ import annotations

import json
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from filtering.errors import quoted
from sequences.errors import SequenceError
from sequences.values import parse_number
from vapor.checkpoints.stored_config import parse_config, parse_metadata
from vapor.evaluation.validation import Validation
from vapor.regressors.base import PoseRegressor
from vapor.storage import published
from vapor.tensor_files import CheckpointError, format_of, read_safetensors, write_safetensors
from vapor.training.memory import TrainingFeatures

FORMAT = "vapor-track training state"
VERSION = 2
_MOMENTS = {"step", "exp_avg", "exp_avg_sq"}  # AdamW's, of a parameter
_ANEW = "remove the file, or train with --no-resume, to start anew"


@dataclass
class TrainingState:
    """A training between two epochs. There is no generator in it: an epoch's randomness follows from seed and number.

    Attributes:
        network: The network being trained.
        average: Its exponential moving average, which is evaluated and becomes the model.
        learner: What gives the network's loss, from `make_learner`.
        optimizer: AdamW, with its moments.
        epochs: How many there will be before the finished model is evaluated.
        epoch: Epochs done; more than that while it goes on with everything.
        seconds: They took so many, evaluation left out.
        history: Figures of the epochs done, where there are held-out images.
        best: Weights of the best epoch so far, on the CPU.
        features: Of the images of the epoch, for a regressor that recalls images; extracted again after an
            interruption.
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
    """Where the state of a training lies whose model will be `output`."""
    return output.with_suffix(".training.safetensors")


def is_training_state(path: Path) -> bool:
    """Whether a file is a training's state."""
    return format_of(path) == FORMAT


def save_state(path: Path, state: TrainingState, identity: Mapping[str, Any]) -> None:
    """Write the state, complete or not at all.

    Args:
        path: From `state_path`.
        state: The training.
        identity: JSON that must be equal for a training to be the same (configuration, data).
    """
    tensors = {f"network.{k}": v for k, v in state.network.state_dict().items()}
    tensors |= {f"average.{k}": v for k, v in state.average.state_dict().items()}
    tensors |= {f"best.{k}": v for k, v in state.best.items()}
    for index, moments in state.optimizer.state_dict()["state"].items():
        tensors |= {f"optimizer.{index}.{k}": v for k, v in moments.items()}
    # Storage is shared where nothing was averaged; safetensors wants each tensor on its own.
    tensors = {k: v.detach().cpu().clone(memory_format=torch.contiguous_format) for k, v in tensors.items()}
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
        CheckpointError: no training state, a damaged one, of another version, of another training, or with other
            tensors.
    """
    try:
        metadata, tensors = read_safetensors(path)
    except CheckpointError as error:
        raise CheckpointError(f"{error}; {_ANEW}") from error
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
            f" configuration and data; {_ANEW}"
        )
    groups: dict[str, dict[str, Tensor]] = {"network": {}, "average": {}, "best": {}, "optimizer": {}}
    for name, value in tensors.items():
        if value.is_complex():
            raise CheckpointError(f"{path}: tensor {name} is of {value.dtype}, expected real numbers")
        group, _, rest = name.partition(".")
        groups.setdefault(group, {})[rest] = value
    try:
        state.network.load_state_dict(groups["network"])
        state.average.load_state_dict(groups["average"])
        moments = _moments(groups["optimizer"], state.optimizer)
        state.optimizer.load_state_dict({**state.optimizer.state_dict(), "state": moments})
        if groups["best"]:
            deepcopy(state.average).load_state_dict(groups["best"])
    except (RuntimeError, ValueError, IndexError) as error:
        raise CheckpointError(f"{path}: {' '.join(str(error).split())}, expected the network's tensors") from error
    state.best = groups["best"]
    try:
        state.epochs, state.epoch = (
            int(parse_number(config.get(name), f"{path}: {name}", 0)) for name in ("epochs", "epoch")
        )
        state.seconds = parse_number(config.get("seconds"), f"{path}: seconds", 0)
    except SequenceError as error:
        raise CheckpointError(str(error)) from error
    history = config.get("history")
    if not isinstance(history, list):
        raise CheckpointError(f"{path}: history is {quoted(history)}, expected a list of the figures of epochs")
    for value in (value for entry in history if isinstance(entry, dict) for value in entry.values()):
        if type(value) not in (int, float):
            raise CheckpointError(f"{path}: history has {quoted(value)}, expected a number")
    state.history = [parse_config(path, "history", Validation, entry) for entry in history]


def _moments(tensors: Mapping[str, Tensor], optimizer: torch.optim.Optimizer) -> dict[int, dict[str, Tensor]]:
    """AdamW's moments by the index of their parameter, in the parameter's memory layout.

    The fused AdamW walks parameter and moments by address: a channels-last parameter with contiguous moments would
    silently be updated with those of other elements.
    """
    parameters = [p for group in optimizer.param_groups for p in group["params"]]
    moments: dict[int, dict[str, Tensor]] = {}
    for name, value in tensors.items():
        index, _, key = name.partition(".")
        alike = value if key == "step" else torch.empty_like(parameters[int(index)]).copy_(value)
        moments.setdefault(int(index), {})[key] = alike.detach()
    for index, each in moments.items():
        if each.keys() != _MOMENTS:
            raise ValueError(f"optimizer.{index} has {quoted(sorted(each))} instead of {quoted(sorted(_MOMENTS))}")
    return moments
