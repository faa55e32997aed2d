"""How long the parts of a step take."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from filtering.config import LocalizerConfig
from filtering.error_model import ErrorModel
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
_STEP = Odometry(Poses.exp(np.array([0.05, 0, 0, 0, 0, 0.01])), np.diag([0.005**2] * 3 + [0.003**2] * 3), 0.1)
_PLACES, _SAMPLES = 30, 1000  # of an image that many places look like


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

    The filter is timed as it ships, over posteriors of that image, finding the places among the samples included; and
    with beliefs of as many hypotheses as asked for, of which none is merged or dropped as light: the lightest are
    thinned out in every step.

    Args:
        model: The network and its number of posterior samples.
        repetitions: Of every part, after three that are not counted.
        hypotheses: Sizes of the beliefs.
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
    if hypotheses:
        posteriors = [model.observe(blurred, rng=rng) for _ in range(repetitions + 4)]
        label = f"filter as it ships, {model.num_samples} samples"
        timings.append(_time_filter(label, LocalizerConfig(), posteriors[0], posteriors[1:], repetitions, rng))
    for count in hypotheses:
        config = LocalizerConfig(max_hypotheses=count, merge_divergence=0.0, least_weight=0.0)
        first, *later = _alike(count, model.description.calibration.errors, repetitions + 4, rng)
        timings.append(_time_filter("filter, none merged", config, first, later, repetitions, rng))
    return timings


def _time_filter(
    label: str,
    config: LocalizerConfig,
    first: PosePosterior,
    later: Sequence[PosePosterior],
    repetitions: int,
    rng: np.random.Generator,
) -> Timing:
    """Time the filter from samples to estimate, and say how many hypotheses it had."""
    localizer, seen, sizes = ParticleLocalizer(None, config, rng=rng), iter(later), []
    localizer.update(first, None)

    def update() -> None:
        posterior = next(seen)
        estimate = localizer.update(PosePosterior.from_samples(posterior.samples, posterior.errors), _STEP)
        sizes.append(len(estimate.log_weights))

    timing = _time(label, update, repetitions)
    return replace(timing, part=f"{label}, {int(np.median(sizes[3:]))} hypotheses")


def _alike(count: int, errors: ErrorModel, images: int, rng: np.random.Generator) -> Iterator[PosePosterior]:
    """Posteriors of a walk through places that all look alike, the first of as many hypotheses as asked for."""
    std = np.asarray(errors.typical_std)
    spots = Poses.exp(rng.uniform(-1.0, 1.0, (_PLACES, 6)) * np.repeat([20.0 * errors.radius_m, 2.0], 3))
    walked = Poses.identity()
    for image in range(images):
        number = _SAMPLES if image else count
        draws = Poses.exp(std * rng.standard_normal((number, 6)))
        samples = spots[rng.integers(0, _PLACES, number)] @ walked @ draws
        if image:
            yield PosePosterior.from_samples(samples, errors)
        else:
            yield PosePosterior.from_estimates(samples, std[0], std[3], errors)
        walked = walked @ _STEP.previous_from_current


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
