"""Models of random weights, of every regressor."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import torch

from filtering.measurement_noise import MeasurementNoise
from filtering.se3 import Poses
from vapor.checkpoints.calibration import Calibration
from vapor.checkpoints.checkpoint import Checkpoint
from vapor.checkpoints.file_format import save_checkpoint
from vapor.regressors.network_config import NetworkConfig, make_regressor
from vapor.regressors.ood_model import OodModel, description_size
from vapor.regressors.retrieval import Memory
from vapor.regressors.scene_box import SceneBox
from vapor.regressors.variational import VariationalPoseRegressor

BOX = SceneBox((-1.0, 0.0, 2.0), (1.0, 10.0, 3.1))
SMALL = NetworkConfig(image_width=32, image_height=32, shortest_edge=36, feature_dim=16, latent_dim=4)


def make_checkpoint(config: NetworkConfig = SMALL, num_poses: int = 30) -> Checkpoint:
    torch.manual_seed(0)
    poses = Poses.exp(np.random.default_rng(0).standard_normal((num_poses, 6)))
    state = VariationalPoseRegressor(config, BOX).state_dict()
    calibration = Calibration(
        0.2, 0.1, replace(MeasurementNoise(), degrees_of_freedom=3.5, noise_floor=(0.1, 0.2, 0.3, 0.01, 0.02, 0.03))
    )
    return Checkpoint(config, BOX, calibration, poses, state, training={"data": ["a.mcap"], "seed": 3})


CONFIG = NetworkConfig(
    backbone="resnet18-quarter", image_width=40, image_height=32, shortest_edge=32, feature_dim=16, latent_dim=4,
    hidden_width=8, hidden_layers=1, components=4,
)  # fmt: skip


@cache
def any_checkpoint(head: str = "variational", *, in_distribution: bool = True) -> Checkpoint:
    """A model of that head; a retrieval network remembers thirty poses."""
    torch.manual_seed(0)
    config, rng = replace(CONFIG, head=head), np.random.default_rng(0)
    network = make_regressor(config, BOX)
    poses = Poses.exp(rng.standard_normal((30, 6)))
    memory = None
    if network.recalling is not None:
        seen = {name: torch.randn(30, *shape) for name, shape in network.recalling.memory_shapes().items()}
        places = torch.from_numpy(poses.translation).float(), torch.from_numpy(poses.rotation).float()
        memory = Memory(seen["keys"], seen["views"], *places)
    known = None
    if in_distribution:
        size = description_size(config.backbone)
        parts = [
            rng.uniform(0.5, 1.0, shape).astype(np.float32) for shape in ((size,), (size,), (size, 4), (4,), (5, 4))
        ]
        known = OodModel(*parts, own_distance=1.0, threshold=2.0)
    return Checkpoint(
        config, BOX, Calibration(), poses, network.state_dict(), training={"seed": 3}, ood_model=known, memory=memory
    )


def remembering(poses: Poses, path: Path) -> Path:
    """A model that remembers images at these poses."""
    checkpoint = any_checkpoint("retrieval", in_distribution=False)
    assert checkpoint.memory is not None
    memory = replace(
        checkpoint.memory,
        keys=checkpoint.memory.keys[: len(poses)],
        views=checkpoint.memory.views[: len(poses)],
        translation=torch.from_numpy(poses.translation).float(),
        rotation=torch.from_numpy(poses.rotation).float(),
    )
    box = SceneBox.around(poses)
    save_checkpoint(path, replace(checkpoint, memory=memory, prior_poses=poses, box=box), store_float16=True)
    return path


def an_image(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (32, 40, 3), dtype=np.uint8)


def noise(columns: int, samples: int = 37) -> np.ndarray:
    return np.random.default_rng(1).standard_normal((samples, columns), dtype=np.float32)
