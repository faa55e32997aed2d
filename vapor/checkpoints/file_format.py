"""The format of model files: a model -> one safetensors file and back, and what files of earlier versions mean."""

from __future__ import annotations

import json
from dataclasses import asdict
from functools import partial
from pathlib import Path

import torch

from filtering.errors import quoted
from filtering.se3 import Poses
from vapor.checkpoints.calibration import parse_calibration, parse_former_calibration, stored_calibration
from vapor.checkpoints.checkpoint import Checkpoint
from vapor.checkpoints.stored_config import parse_box, parse_camera, parse_config, parse_metadata
from vapor.checkpoints.stored_tensors import (
    FAMILIARITY,
    NETWORK,
    PRIOR_ROTATION,
    PRIOR_TRANSLATION,
    check_tensors,
    familiarity_like,
    familiarity_tensors,
    memory_like,
    memory_tensors,
    read_familiarity,
    read_memory,
)
from vapor.checkpoints.thinning import thin_poses
from vapor.regressors.familiarity import description_size
from vapor.regressors.network_config import NetworkConfig
from vapor.regressors.registry import make_regressor
from vapor.stored_names import with_stored_names
from vapor.tensor_files import CHECKSUM, CheckpointError, format_of, read_safetensors, write_safetensors

FORMAT = "vapor-track model"
VERSION = 8
_BEFORE_MISTAKES = "7"  # mistakes about the place were taken to last as long as errors within it
_BEFORE_GROWTH = "6"  # images were taken to err alike, however unfamiliar
_NO_MISTAKES = {"mistaken_lengths": 1.0}  # what error models of those versions had without stating it
_NO_GROWTH = {"unfamiliar_power": 0.0, "unfamiliar_score": 0.5, **_NO_MISTAKES}
_BEFORE_ERRORS = ("4", "5")  # their calibrations are of another filter: only the kernel widths are taken
_BEFORE_SHORTCUT = "4"
_NO_SHORTCUT = {"shortcut": False}  # what networks of that version had without stating it


def save_checkpoint(path: Path, checkpoint: Checkpoint, *, store_float16: bool = False) -> None:
    """Write a model file, complete or not at all.

    Args:
        path: A file name, usually *.safetensors.
        checkpoint: What to write; more than 2000 prior poses are thinned evenly.
        store_float16: Store weight matrices as float16, for half the size; biases and BatchNorm stay float32.
    """
    poses = thin_poses(checkpoint.prior_poses)
    tensors = {PRIOR_ROTATION: torch.from_numpy(poses.rotation), PRIOR_TRANSLATION: torch.from_numpy(poses.translation)}
    for name, value in checkpoint.state_dict.items():
        smaller = store_float16 and value.is_floating_point() and value.ndim > 1
        tensors[NETWORK + name] = value.to(torch.float16) if smaller else value
    if checkpoint.familiarity is not None:
        tensors |= familiarity_tensors(checkpoint.familiarity)
    if checkpoint.memory is not None:
        tensors |= memory_tensors(checkpoint.memory, store_float16=store_float16)
    config = {
        "network": asdict(checkpoint.network),
        "box": asdict(checkpoint.box),
        "calibration": stored_calibration(checkpoint.calibration),
        "training": with_stored_names(checkpoint.training),
        "camera": None if checkpoint.camera is None else asdict(checkpoint.camera),
    }
    metadata = {"format": FORMAT, "version": str(VERSION), "config": json.dumps(config, allow_nan=False)}
    write_safetensors(path, tensors, metadata)


def load_checkpoint(path: Path) -> Checkpoint:
    """Read a model file, strictly.

    The calibration in files of format 4 and 5 is that of an earlier filter: its kernel widths are taken, and the rest
    are the errors of a model that was not calibrated (`default_errors`); calibrate such a model anew. In files of
    format 6 errors do not grow with how unfamiliar an image is; in those and in files of format 7 mistakes about the
    place last as long as errors within it.

    Raises:
        CheckpointError: no such file, no safetensors file, a damaged one, another format or version, a configuration
            with missing, surplus or unusable values, tensors that are missing, surplus, misshapen, of another type or
            not finite, or prior poses that are not rigid.
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
        network = network | _NO_SHORTCUT
    network = parse_config(path, "network", NetworkConfig, network)
    box = parse_box(path, config.get("box"))
    training = config.get("training")
    if not isinstance(training, dict):
        raise CheckpointError(f"{path}: training is {type(training).__name__} in its configuration, expected an object")

    with torch.device("meta"):  # names and shapes only, no memory
        regressor = make_regressor(network, box)
        expected = regressor.state_dict()
        known = familiarity_like(tensors, description_size(regressor)) | memory_like(tensors, regressor)
    check_tensors(path, tensors, {NETWORK + name: value for name, value in expected.items()} | known)
    state = {name: tensors[NETWORK + name] for name in expected}
    state = {name: value.float() if value.is_floating_point() else value for name, value in state.items()}
    poses = Poses(tensors[PRIOR_ROTATION].double().numpy(), tensors[PRIOR_TRANSLATION].double().numpy())
    if version in _BEFORE_ERRORS:
        parse = partial(parse_former_calibration, prior_poses=poses)
    else:
        parse = partial(
            parse_calibration, missing={_BEFORE_MISTAKES: _NO_MISTAKES, _BEFORE_GROWTH: _NO_GROWTH}.get(version, {})
        )
    calibration = parse(path, config.get("calibration"))
    familiarity = read_familiarity(path, tensors) if any(name.startswith(FAMILIARITY) for name in known) else None
    camera = parse_camera(path, config.get("camera"))
    memory = read_memory(path, tensors) if regressor.recalling else None
    unchecked = f"{path.name} was written before model files had checksums: whether it is damaged cannot be told"
    notices = () if CHECKSUM in metadata else (unchecked,)
    return Checkpoint(network, box, calibration, poses, state, training, familiarity, camera, memory, notices)


def is_model(path: Path) -> bool:
    """Whether a file is a model of any version of this package, by what it says of itself."""
    return format_of(path) == FORMAT
