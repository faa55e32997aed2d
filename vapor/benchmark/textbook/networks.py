"""How long our whole step takes, image bytes to estimate, and the paper's network in plain PyTorch beside it."""

from __future__ import annotations

import time
from collections.abc import Callable
from itertools import cycle
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
import torch

from filtering.config import LocalizerConfig
from filtering.localizer import ParticleLocalizer
from sequences.frame import Frame
from sequences.images.decoding import decode_image_bytes
from sequences.reader import SequenceReader
from sequences.synthesize import synthesize, write_synthetic
from vapor.benchmark.timing import Timing
from vapor.images import prepare
from vapor.observation import VaporObservationModel
from vapor.regressors.network_config import NetworkConfig
from vapor.regressors.registry import make_regressor
from vapor.regressors.scene_box import SceneBox
from vapor.threads import limited_threads

PAPER = "paper: network alone, eager PyTorch"
OURS = "ours: network alone"
WHOLE = "ours: whole step, image bytes to estimate"

_WARM_UP = 3


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
    frames = _frames(scene, size, min(repetitions + _WARM_UP, 30), seed)
    encoded = [bytes(cv2.imencode(".jpg", frame.image[..., ::-1])[1]) for frame in frames]
    rng = np.random.default_rng(seed)
    localizer = ParticleLocalizer(model, config, rng=rng)
    ask = _plain(paper, model.num_samples)
    at = cycle(range(len(frames)))
    parts: dict[str, Callable[[int], object]] = {
        PAPER: lambda i: ask(frames[i].image),
        OURS: lambda i: model.observe(frames[i].image, rng=rng),
        # From the last image to the first one the camera jumps, as if nothing were known of how it moved.
        WHOLE: lambda i: localizer.step(decode_image_bytes(encoded[i]), frames[i].odometry if i else None),
    }
    durations_ms: dict[str, list[float]] = {part: [] for part in parts}
    with limited_threads(1):
        for _ in range(repetitions + _WARM_UP):
            i = next(at)
            for part, call in parts.items():
                begin = time.perf_counter()
                call(i)
                durations_ms[part].append(1e3 * (time.perf_counter() - begin))
    return [Timing(part, *map(float, np.percentile(each[_WARM_UP:], [50, 95]))) for part, each in durations_ms.items()]


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
