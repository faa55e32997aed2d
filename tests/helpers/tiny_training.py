"""Training that takes seconds, whole or interrupted, on images of noise to learn by heart."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from filtering.se3 import Poses
from sequences.frame import Frame
from vapor.regressors.loss_config import LossConfig
from vapor.regressors.network_config import NetworkConfig
from vapor.training.augment_config import AugmentConfig
from vapor.training.config import TrainConfig
from vapor.training.train import train_on

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


def walks() -> dict[str, list[Frame]]:
    """Four walks of 24 images along the same line, of which one is held out."""
    frames = make_frames(96)
    poses = [Poses(np.eye(3), np.array([0.1 * i, 0.0, 0.0])) for i in range(24)]
    moved = [replace(frame, world_from_camera=poses[i % 24]) for i, frame in enumerate(frames)]
    return {name: moved[24 * i : 24 * (i + 1)] for i, name in enumerate("abcd")}


def pose(frame: Frame) -> Poses:
    assert frame.world_from_camera is not None
    return frame.world_from_camera


def train_on_most(frames: list[Frame], output: Path, config: TrainConfig, **more):
    count = len(frames) * 3 // 4
    held_out = [
        replace(late, world_from_camera=pose(early)) for late, early in zip(frames[count:], frames, strict=False)
    ]
    return train_on({"a": frames[:count]}, output, config, validation={"b": held_out}, **more)


class Interrupted(Exception):
    pass


def interrupt_at(step: int):
    def progress(p):
        if p.stage == "training" and p.done == step:
            raise Interrupted

    return progress


def same_weights(a, b) -> bool:
    return all(torch.equal(a.state_dict[k], v) for k, v in b.state_dict.items())


TINY_TRAIN = TrainConfig(
    network=NetworkConfig(image_width=32, image_height=32, shortest_edge=34, feature_dim=16, latent_dim=4),
    bandwidth_translation_m=2.0,
    bandwidth_rotation_rad=2.0,  # so wide that the density at the truth is more than its floor
    epochs=1,
    batch_size=16,
    calibrate=False,
    validation_fraction=0.0,
)
