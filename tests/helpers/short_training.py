"""Training runs of seconds, whole or interrupted."""

from dataclasses import replace
from pathlib import Path

import torch

from sequences.frame import Frame
from tests.helpers.tiny_training import pose
from vapor.training.config import TrainConfig
from vapor.training.train import train_on


def train_on_most(frames: list[Frame], output: Path, config: TrainConfig, **more):
    """The last quarter is held out, taken where the first images were."""
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
