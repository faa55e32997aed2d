"""What the stages share: the device, how much is measured, and the walk that is localized."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import Literal

import torch

from sequences.frame import Frame
from sequences.reader import SequenceReader
from sequences.synthesize import synthesize, write_synthetic
from vapor.benchmark.gpu.stages import Deadline
from vapor.benchmark.untrained import untrained
from vapor.checkpoints.checkpoint import Checkpoint
from vapor.checkpoints.file_format import find_model, load_checkpoint
from vapor.regressors.network_config import NetworkConfig
from vapor.training.presets import PRESETS

MODEL = "staircase"
"""The model that ships, and the scene of its walk."""
_SEED = 2  # of a walk that is ambiguous for long, and becomes converged twice


@dataclass(frozen=True)
class Sizes:
    """How much is measured.

    Attributes:
        paper: The paper's network, or a small one in its place.
        repetitions: Of every time, at most.
        samples: Posterior samples of an image.
        compared: Images of which the samples are compared.
        batches: Numbers of images in a batch.
        walk: Images of the walk.
        width, height: Of the images that are rendered.
        training, held_out: Images to train with.
        training_batches: Numbers of images in a training step.
        epochs: At most, until recalls are compared.
        landmarks: Matched points of a place.
    """

    paper: NetworkConfig = PRESETS["paper-synthetic"].network
    repetitions: int = 50
    samples: int = 1000
    compared: int = 16
    batches: tuple[int, ...] = (1, 8, 64)
    walk: int = 120
    width: int = 320
    height: int = 240
    training: int = 500
    held_out: int = 60
    training_batches: tuple[int, ...] = (4, 64)
    epochs: int = 200
    landmarks: int = 1000


TINY = Sizes(
    paper=NetworkConfig(
        "resnet18-quarter",
        image_width=32,
        image_height=32,
        shortest_edge=36,
        feature_dim=16,
        latent_dim=4,
        shortcut=False,
    ),
    repetitions=2,
    samples=50,
    compared=2,
    batches=(1, 2),
    walk=4,
    width=80,
    height=60,
    training=8,
    held_out=2,
    training_batches=(4,),
    epochs=2,
    landmarks=100,
)
"""So little that it shows only whether everything runs."""


@dataclass(frozen=True)
class Setting:
    """The device that is measured, the sizes, processor threads, and a folder for files."""

    device: Literal["cpu", "cuda"]
    sizes: Sizes
    directory: Path
    threads: int = 1

    @property
    def torch_device(self) -> torch.device:
        """The device, for torch."""
        return torch.device(self.device)

    @cached_property
    def trained(self) -> Checkpoint:
        """The model that ships."""
        return load_checkpoint(find_model(MODEL))

    @cached_property
    def networks(self) -> dict[str, Checkpoint]:
        """The networks that are measured: that of the model, and the paper's with random weights."""
        paper = self.sizes.paper
        of_paper = f"{paper.backbone} at {paper.image_width} × {paper.image_height}"
        return {f"{MODEL} model": self.trained, of_paper: untrained(paper)}

    def walk(self, deadline: Deadline) -> Path:
        """The walk, rendered by the first stage that asks for it."""
        file, s = self.directory / "walk.mcap", self.sizes
        if not file.exists():
            sequence = synthesize(MODEL, seed=_SEED, num_frames=s.walk, width=s.width, height=s.height)
            write_synthetic(sequence, file, progress=deadline.check)
        return file

    def frames(self, deadline: Deadline, most: int | None = None) -> list[Frame]:
        """The first images of the walk, decoded; all where no number is given."""
        return list(islice(SequenceReader(self.walk(deadline)), most))
