"""Training that takes seconds: its settings, and images of noise to learn by heart."""

import numpy as np

from filtering.se3 import Poses
from sequences.frame import Frame
from vapor.regressors.loss import LossConfig
from vapor.regressors.network_config import NetworkConfig
from vapor.training.augment import AugmentConfig
from vapor.training.config import TrainConfig

STILL = AugmentConfig("central", 0.0, 0.0, 0.0, 0.0, 0.0)
TINY = TrainConfig(
    network=NetworkConfig(
        "resnet18-quarter",
        image_width=32,
        image_height=32,
        shortest_edge=36,
        feature_dim=64,
        latent_dim=4,
        hidden_width=64,
        hidden_layers=2,
    ),
    aspect="network",
    loss=LossConfig(num_samples=64, position_unit="metre"),
    bandwidth_translation_m=1.0,
    bandwidth_rotation_rad=1.0,  # wide, so that a few steps move the held-out density
    learning_rate=1e-3,
    select_by="log_density",  # moves from the first epoch on, when no sample is near yet
    epochs=4,
    batch_size=8,
    validation_fraction=0.25,
    precision="float32",
    device="cpu",
)


def make_frames(count: int, seed: int = 0, places: int | None = None) -> list[Frame]:
    """Noise images with random poses within ±2 m; image i is that of place i modulo `places`."""
    rng = np.random.default_rng(seed)
    images = rng.integers(0, 256, (places or count, 36, 48, 3), dtype=np.uint8)
    tangents = rng.uniform(-1, 1, (count, 6)) * [2, 2, 2, 1, 1, 1]
    return [Frame(i, images[i % len(images)], None, Poses.exp(t)) for i, t in enumerate(tangents)]


def pose(frame: Frame) -> Poses:
    assert frame.world_from_camera is not None
    return frame.world_from_camera
