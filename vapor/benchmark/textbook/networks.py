"""How long our whole step takes, image bytes to estimate, and the paper's network in plain PyTorch beside it."""

from __future__ import annotations

from collections.abc import Callable
from itertools import cycle
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch

from filtering.config import LocalizerConfig
from filtering.localizer import ParticleLocalizer
from sequences.frame import Frame
from sequences.reader import SequenceReader
from sequences.synthesize import synthesize, write_synthetic
from vapor.benchmark.timing import Timing, WholeStep, time_by_turns
from vapor.images import prepare
from vapor.observation import VaporObservationModel
from vapor.regressors.network_config import NetworkConfig
from vapor.regressors.registry import make_regressor
from vapor.regressors.scene_box import SceneBox
from vapor.threads import limited_threads

PAPER = "paper: network alone, eager PyTorch"
OURS = "ours: network alone"
WHOLE = "ours: whole step, image bytes to estimate"


def time_networks(
    scene: str,
    model: VaporObservationModel,
    paper: NetworkConfig,
    config: LocalizerConfig,
    *,
    size: tuple[int, int],
    repetitions: int,
    seed: int,
) -> list[Timing]:
    """Time the paper's network and ours, alternately, one thread each, on rendered images of a scene.

    Args:
        scene: Its name.
        model: Our network, for this scene.
        paper: The paper's network; random weights take as long as trained ones.
        config: Settings of the filter.
        size: Width and height of the images, pixels.
        repetitions: Of each, after three that are not counted.
        seed: Of the images and all draws.
    """
    frames = _frames(scene, size, min(repetitions, 30), seed)
    rng = np.random.default_rng(seed)
    ask, images = _plain(paper, model.num_samples), {part: cycle(frames) for part in (PAPER, OURS)}
    parts: dict[str, Callable[[], object]] = {
        PAPER: lambda: ask(next(images[PAPER]).image),
        OURS: lambda: model.observe(next(images[OURS]).image, rng=rng),
        WHOLE: WholeStep(ParticleLocalizer(model, config, rng=rng), frames),
    }
    with limited_threads(1):
        return time_by_turns(parts, repetitions)


def _plain(config: NetworkConfig, num_samples: int) -> Callable[[np.ndarray], object]:
    """The network as its paper's code runs it: module calls, one after the other."""
    box = SceneBox((-5.0, -5.0, 0.0), (5.0, 5.0, 3.0))
    network = make_regressor(config, box).eval()

    def ask(image: np.ndarray) -> object:
        with torch.inference_mode():
            pixels = network.normalise(torch.from_numpy(np.ascontiguousarray(prepare(image, config)[None])))
            return network(pixels.contiguous(), torch.randn(1, num_samples, network.noise_dim))

    return ask


def _frames(scene: str, size: tuple[int, int], count: int, seed: int) -> list[Frame]:
    sequence = synthesize(scene, seed=seed, num_frames=count, width=size[0], height=size[1])
    with TemporaryDirectory() as folder:
        file = Path(folder) / "sequence.mcap"
        write_synthetic(sequence, file)
        return list(SequenceReader(file))
