"""How long the parts of a step take."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from filtering.config import LocalizerConfig
from filtering.localizer import ParticleLocalizer
from filtering.motion import Odometry
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from sequences.images.decoding import decode_image_bytes
from vapor.checkpoints.calibration import Calibration
from vapor.checkpoints.checkpoint import Checkpoint
from vapor.observation import VaporObservationModel
from vapor.regressors.network_config import NetworkConfig
from vapor.regressors.registry import make_regressor
from vapor.regressors.scene_box import SceneBox

_IMAGE_SHAPE = (240, 320, 3)


@dataclass(frozen=True)
class Timing:
    """Wall-clock time of one part of a step.

    Attributes:
        part: What was timed.
        median_ms: Median over the repetitions, milliseconds.
        p95_ms: 95th percentile, milliseconds.
    """

    part: str
    median_ms: float
    p95_ms: float


def time_step(model: VaporObservationModel, *, repetitions: int, hypotheses: Sequence[int], seed: int) -> list[Timing]:
    """Time decoding, network and filter separately, on an image of noise and with odometry at walking pace.

    Args:
        model: The network and its number of posterior samples.
        repetitions: Of every part, after three that are not counted.
        hypotheses: Sizes of the filter to time; finding the places among the samples is part of its step.
        seed: Of the image and all draws.
    """
    rng = np.random.default_rng(seed)
    image = rng.integers(0, 256, _IMAGE_SHAPE, dtype=np.uint8)
    blurred = cv2.GaussianBlur(image, (0, 0), 3)  # compresses like a photograph, unlike noise
    encoded = bytes(cv2.imencode(".jpg", blurred, [cv2.IMWRITE_JPEG_QUALITY, 90])[1])
    timings = [
        _time("decode a JPEG image of 320 × 240", lambda: decode_image_bytes(encoded), repetitions),
        _time(f"network, {model.num_samples} samples", lambda: model.observe(blurred, rng=rng), repetitions),
    ]
    step = Odometry(Poses.exp(np.array([0.05, 0, 0, 0, 0, 0.01])), np.diag([0.005**2] * 3 + [0.003**2] * 3), 0.1)
    for count in hypotheses:
        localizer = ParticleLocalizer(model, LocalizerConfig(max_hypotheses=count), rng=rng)
        localizer.step(blurred, None)
        seen = iter([model.observe(blurred, rng=rng) for _ in range(repetitions + 3)])
        label = f"filter, {count} hypotheses at most"

        def update(localizer: ParticleLocalizer = localizer, seen: Iterator[PosePosterior] = seen) -> None:
            posterior = next(seen)
            localizer.update(PosePosterior.from_samples(posterior.samples, posterior.errors), step)

        timings.append(_time(label, update, repetitions))
    return timings


def untrained(config: NetworkConfig) -> Checkpoint:
    """A model with random weights: it takes as long as a trained one."""
    box = SceneBox((-5.0, -5.0, 0.0), (5.0, 5.0, 3.0))
    weights = make_regressor(config, box).state_dict()
    return Checkpoint(config, box, Calibration(), Poses.exp(np.zeros((1, 6))), weights, {})


def _time(part: str, call: Callable[[], object], repetitions: int) -> Timing:
    durations_ms = []
    for _ in range(repetitions + 3):
        begin = time.perf_counter()
        call()
        durations_ms.append(1e3 * (time.perf_counter() - begin))
    median_ms, p95_ms = np.percentile(durations_ms[3:], [50, 95])
    return Timing(part, float(median_ms), float(p95_ms))
