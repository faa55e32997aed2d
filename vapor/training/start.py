"""What a training starts from: first weights, from the seed or from files, and a fresh optimizer."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import Any

import torch

from filtering.se3 import Poses
from vapor.checkpoints.checkpoint import Checkpoint
from vapor.checkpoints.file_format import load_checkpoint
from vapor.engines.device import resolve_device
from vapor.regressors.base import PoseRegressor
from vapor.regressors.pretrained import load_pretrained
from vapor.regressors.registry import make_regressor
from vapor.regressors.scene_box import SceneBox
from vapor.training.config import TrainConfig
from vapor.training.processes import make_learner
from vapor.training.state import TrainingState
from vapor.training_data.training_set import TrainingError


def initial_model(config: TrainConfig) -> Checkpoint | None:
    """The model all of whose weights are the start, if one is configured.

    Raises:
        TrainingError: its network has another shape.
        CheckpointError: it cannot be read.
    """
    if config.initial_model is None:
        return None
    initial = load_checkpoint(config.initial_model)
    wanted = config.network
    sizes = {name: getattr(wanted, name) for name in ("image_width", "image_height", "shortest_edge")}
    shortcut = initial.network.shortcut or wanted.shortcut  # `take_weights` adds one that is missing
    found = replace(initial.network, shortcut=shortcut, **sizes)  # convolutions fit images of any size
    if other := [name for name, value in asdict(wanted).items() if getattr(found, name) != value]:
        told = ", ".join(f"{name} {getattr(found, name)!r} (expected {getattr(wanted, name)!r})" for name in other)
        raise TrainingError(f"{config.initial_model}: its network has {told} as configured")
    return initial


def start(config: TrainConfig, box: SceneBox, poses: Poses, initial: Checkpoint | None) -> TrainingState:
    """A network before its first step, its average, which is a copy, and its optimizer, on the configured device.

    Args:
        config: How it will be trained.
        box: Where cameras can be.
        poses: world_from_camera of the training images, (n,); some regressors start from them.
        initial: From `initial_model`.

    Raises:
        VaporTrackError: weights of the backbone or the device are not there.
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
        network.take_weights(initial.state_dict)
    average.load_state_dict(network.state_dict())
    network, average = (
        n.to(device).to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
        for n in (network, average)
    )
    learner = make_learner(network)
    optimizer = torch.optim.AdamW(parameter_groups(network, config), lr=config.learning_rate, fused=True)
    return TrainingState(network, average, learner, optimizer)


def parameter_groups(network: PoseRegressor, config: TrainConfig) -> list[dict[str, Any]]:
    """Matrices of the encoder, those of the rest, and what does not decay: biases and BatchNorm."""
    encoder = {id(p) for part in network.encoder for p in part.parameters()}
    matrices = [p for p in network.parameters() if p.ndim > 1]
    decay = config.weight_decay if config.encoder_weight_decay is None else config.encoder_weight_decay
    return [
        {"params": [p for p in matrices if id(p) in encoder], "weight_decay": decay},
        {"params": [p for p in matrices if id(p) not in encoder], "weight_decay": config.weight_decay},
        {"params": [p for p in network.parameters() if p.ndim <= 1], "weight_decay": 0.0},
    ]
