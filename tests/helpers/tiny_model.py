"""A network that knows nothing, for tests of everything around it; and a model file's parts, to damage them."""

from collections.abc import Callable
from pathlib import Path

import torch

from filtering.se3 import Poses
from tests.helpers.sequence_files import Walk
from vapor.checkpoints.calibration import Calibration
from vapor.checkpoints.checkpoint import Checkpoint
from vapor.checkpoints.file_format import save_checkpoint
from vapor.regressors.network_config import NetworkConfig
from vapor.regressors.scene_box import SceneBox
from vapor.regressors.variational import VariationalPoseRegressor
from vapor.tensor_files import read_safetensors, write_safetensors

NETWORK = NetworkConfig(image_width=32, image_height=32, shortest_edge=36, feature_dim=16, latent_dim=4)
SMALL = ["--engine", "torch", "--num-samples", "60", "--localizer.max-hypotheses", "40"]
"""Options of `vapor-track run` that make a step cheap, and its start: to compile a network takes seconds."""

Tensors = dict[str, torch.Tensor]
Metadata = dict[str, str]


def write_tiny_model(path: Path) -> Path:
    """Random weights, with the box and the poses of the walk."""
    torch.manual_seed(0)
    poses = Poses.stack([pose for _, pose in Walk().truth])
    box = SceneBox.around(poses)
    state = VariationalPoseRegressor(NETWORK, box).state_dict()
    save_checkpoint(path, Checkpoint(NETWORK, box, Calibration(), poses, state), store_float16=True)
    return path


def altered(model: Path, path: Path, change: Callable[[Tensors, Metadata], None]) -> Path:
    """A copy of a model file whose tensors or metadata were changed in place, with a checksum that fits them."""
    metadata, tensors = read_safetensors(model)
    change(tensors, metadata)
    write_safetensors(path, tensors, metadata)
    return path
