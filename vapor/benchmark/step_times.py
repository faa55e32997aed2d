"""Times of the parts of a step: decoding, network, landmarks, filter; and of whole steps."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import cycle

import cv2
import numpy as np
from jaxtyping import UInt8

from filtering.config import LocalizerConfig
from filtering.localizer import ParticleLocalizer
from filtering.measurement_noise import MeasurementNoise
from filtering.motion import Odometry
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from sequences.frame import Frame
from sequences.images.decoding import decode_image_bytes
from vapor.observation import VaporObservationModel
from vapor.reporting.drawing import as_jpeg

_IMAGE_SHAPE = (240, 320, 3)
_STEP = Odometry(Poses.exp(np.array([0.05, 0, 0, 0, 0, 0.01])), np.diag([0.005**2] * 3 + [0.003**2] * 3), 0.1)
_QUALITY = 90  # of JPEG images
_WARM_UP = 3  # times that are not counted
_PLACES, _SAMPLES = 30, 1000  # of an image that many places look like


@dataclass(frozen=True)
class Timing:
    """Wall-clock time of one part of a step: median and percentiles over the repetitions, milliseconds."""

    part: str
    median_ms: float
    p95_ms: float
    p99_ms: float


def time_step(
    models: Mapping[str, VaporObservationModel],
    *,
    repetitions: int,
    hypotheses: Sequence[int],
    frames: Sequence[Frame] = (),
) -> list[Timing]:
    """Time decoding, network and filter separately; and, on a recording's images, landmarks and a whole step.

    The filter is timed as it ships, over posteriors of one image, finding the places among the samples included; and
    with beliefs of as many hypotheses as asked for, of which none is merged or dropped as light: the lightest are
    thinned out in every step.

    Args:
        models: The network by each way to run it, which take turns, and its number of posterior samples.
        repetitions: Of every part, after three that are not counted.
        hypotheses: Sizes of the beliefs.
        frames: Images and odometry. Without any, the image is blurred noise, and no whole step is timed.
    """
    rng = np.random.default_rng(0)
    image = frames[0].image if frames else blurred_noise(rng)
    height, width, _ = image.shape
    encoded = as_jpeg(image, _QUALITY)
    timings = [_time(f"decode a JPEG image of {width} × {height}", lambda: decode_image_bytes(encoded), repetitions)]
    timings += _time_by_turns(
        {
            f"network by {way}, {model.num_samples} samples": partial(model.propose, image, rng=rng)
            for way, model in models.items()
        },
        repetitions,
    )
    if frames:
        timings += _time_landmarks(next(iter(models.values())), frames, repetitions, rng)
        timings += _time_by_turns(
            {
                f"whole step by {way}, image bytes to estimate": _whole_step(ParticleLocalizer(model, rng=rng), frames)
                for way, model in models.items()
            },
            repetitions,
        )
    model = next(iter(models.values()))
    if hypotheses:
        posteriors = [model.observe(image, rng=rng) for _ in range(repetitions + _WARM_UP + 1)]
        label = f"filter as it ships, {model.num_samples} samples"
        timings.append(_time_filter(label, LocalizerConfig(), posteriors[0], posteriors[1:], repetitions, rng))
    for count in hypotheses:
        config = LocalizerConfig(max_hypotheses=count, merge_divergence=0.0, least_weight=0.0)
        first, *later = _alike(count, model.description.calibration.errors, repetitions + _WARM_UP + 1, rng)
        timings.append(_time_filter("filter, none merged", config, first, later, repetitions, rng))
    return timings


def _time_by_turns(parts: Mapping[str, Callable[[], object]], repetitions: int) -> list[Timing]:
    """Time calls that take turns, so that all have their share of what else the machine does."""
    durations_ms: dict[str, list[float]] = {part: [] for part in parts}
    for _ in range(repetitions + _WARM_UP):
        for part, call in parts.items():
            begin = time.perf_counter()
            call()
            durations_ms[part].append(1e3 * (time.perf_counter() - begin))
    return [
        Timing(part, *map(float, np.percentile(each[_WARM_UP:], [50, 95, 99]))) for part, each in durations_ms.items()
    ]


def _time_landmarks(
    model: VaporObservationModel, frames: Sequence[Frame], repetitions: int, rng: np.random.Generator
) -> list[Timing]:
    """Time what landmarks add to a step, image by image; nothing of a model without them."""
    if model.verifier is None:
        return []
    verifier, camera = model.verifier, model.camera
    proposed = cycle([(frame.image, model.propose(frame.image, rng=rng)) for frame in frames])

    def verify() -> None:
        image, posterior = next(proposed)
        verifier.verify(image, camera, posterior)

    return [_time("landmarks: features, matches, verified poses", verify, repetitions)]


def _whole_step(localizer: ParticleLocalizer, frames: Sequence[Frame]) -> Callable[[], object]:
    """From an image's bytes to the estimate: every call is a step on the next image of a recording, over and over.

    From the last image to the first one the camera jumps, as if nothing were known of how it moved.
    """
    motions = [None, *(frame.odometry for frame in frames[1:])]
    images = cycle(list(zip([as_jpeg(frame.image, _QUALITY) for frame in frames], motions, strict=True)))

    def step() -> None:
        encoded, odometry = next(images)
        localizer.step(decode_image_bytes(encoded), odometry)

    return step


def blurred_noise(rng: np.random.Generator) -> UInt8[np.ndarray, "h w 3"]:
    """An image that compresses like a photograph, unlike noise."""
    return cv2.GaussianBlur(rng.integers(0, 256, _IMAGE_SHAPE, dtype=np.uint8), (0, 0), 3).astype(np.uint8)


def _time_filter(
    label: str,
    config: LocalizerConfig,
    first: PosePosterior,
    later: Sequence[PosePosterior],
    repetitions: int,
    rng: np.random.Generator,
) -> Timing:
    """Time the filter from samples to estimate, and state how many hypotheses it had."""
    localizer, seen, sizes = ParticleLocalizer(None, config, rng=rng), iter(later), []
    localizer.update(first, None)

    def update() -> None:
        posterior = next(seen)
        estimate = localizer.update(PosePosterior.from_samples(posterior.samples, posterior.noise), _STEP)
        sizes.append(len(estimate.log_weights))

    timing = _time(label, update, repetitions)
    return replace(timing, part=f"{label}, {int(np.median(sizes[_WARM_UP:]))} hypotheses")


def _alike(count: int, noise: MeasurementNoise, images: int, rng: np.random.Generator) -> Iterator[PosePosterior]:
    """Posteriors of a walk through places that all look alike, the first of as many hypotheses as asked for."""
    std = np.asarray(noise.typical_std)
    spots = Poses.exp(rng.uniform(-1.0, 1.0, (_PLACES, 6)) * np.repeat([20.0 * noise.radius_m, 2.0], 3))
    walked = Poses.identity()
    for image in range(images):
        number = _SAMPLES if image else count
        draws = Poses.exp(std * rng.standard_normal((number, 6)))
        samples = spots[rng.integers(0, _PLACES, number)] @ walked @ draws
        if image:
            yield PosePosterior.from_samples(samples, noise)
        else:
            yield PosePosterior.from_estimates(samples, std[0], std[3], noise)
        walked = walked @ _STEP.previous_from_current


def _time(part: str, call: Callable[[], object], repetitions: int) -> Timing:
    return _time_by_turns({part: call}, repetitions)[0]
