"""Frame by frame through a sequence: observe, track, show, write."""

from __future__ import annotations

import sys
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from operator import attrgetter
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np

from filtering.errors import VaporTrackError
from filtering.hindsight import FilterStep
from filtering.localizer import ParticleLocalizer
from filtering.measurement_noise import MeasurementNoise
from filtering.observation import ONLY_CAMERA, Observation
from filtering.posterior import ObservationModel, PosePosterior
from filtering.storeys import Storeys
from filtering.vertical import Vertical
from sequences.estimates.sequence import EstimateSequence
from sequences.frame_source import FrameSource
from vapor.pipeline.config import FilteringConfig
from vapor.reporting.record import RunRecord
from vapor.reporting.rerun_place import Place
from vapor.reporting.run_outputs import RunOutputs
from vapor.tracking.hindsight import LookBack
from vapor.tracking.loop import StepLoop, elapsed_s
from vapor.tracking.methods import BESIDE_RUNS, start_baselines

Item = TypeVar("Item")

_ROOM = 2  # items that wait at most; one more is being computed
_TURN_S = 2e-4  # between threads: Python's 5 ms are as long as the network takes for an image


@contextmanager
def ahead(items: Iterable[Item]) -> Iterator[Iterator[Item]]:
    """The same items in the same order, computed in a thread while those before are in use.

    An error comes in the place of the item that it kept from being computed. The thread has ended at the end of the
    block, however that ends.
    """
    source, end = (item for item in items), object()
    turn_s = sys.getswitchinterval()
    sys.setswitchinterval(min(turn_s, _TURN_S))
    thread = ThreadPoolExecutor(1)
    waiting = deque(thread.submit(next, source, end) for _ in range(_ROOM + 1))

    def computed() -> Iterator[Item]:
        while (item := waiting.popleft().result()) is not end:
            yield cast(Item, item)
            waiting.append(thread.submit(next, source, end))

    try:
        yield computed()
    finally:
        thread.shutdown(cancel_futures=True)
        source.close()
        sys.setswitchinterval(turn_s)


def localize(
    source: FrameSource | EstimateSequence,
    model: ObservationModel,
    directory: Path,
    config: FilteringConfig,
    noise: MeasurementNoise,
    *,
    observed: Callable[[Any], np.ndarray] = attrgetter("image"),
    storeys: Storeys | None = None,
    vertical: Callable[[Any, PosePosterior], Vertical | None] = lambda frame, posterior: None,
    place: Place | None = None,
    allow_few_images: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> RunRecord:
    """Localize frame after frame, show and write each; then smooth.

    Args:
        source: The frames.
        model: Maps an observation to its posterior.
        directory: Where `estimate.mcap` and `recording.rrd` go.
        config: Settings.
        noise: How the model's posteriors err.
        observed: The observation of a frame.
        storeys: Of the building, where there are several.
        vertical: What is known of the vertical of a frame, also by its posterior.
        place: Where it happens, for the viewer.
        allow_few_images: Whether fewer than one in ten of the images asked for are enough.
        progress: Called after every frame with the number done and about how many there will be.

    Raises:
        VaporTrackError: unusable frames, none, or too few.
    """
    settings = config.localizer
    rng = partial(np.random.default_rng, config.seed)
    localizer = ParticleLocalizer(model, settings, rng=rng())
    loop = StepLoop(localizer, start_baselines(settings, rng, only=BESIDE_RUNS))
    steps: list[FilterStep] = []
    on_storeys: list[np.ndarray] = []

    def observations(frames: Iterable[Any]) -> Iterator[tuple[Any, Observation, float]]:
        before_ns: int | None = None
        for frame in frames:
            begin = time.perf_counter()
            with _about(frame, source):
                posterior = localizer.observe(observed(frame), camera=frame.camera_name or ONLY_CAMERA)
            observation = Observation.of_posterior(
                posterior,
                frame.odometry,
                elapsed_s(before_ns, frame.time_ns),
                reference_from_camera=frame.reference_from_camera,
                camera=frame.camera_name or ONLY_CAMERA,
            )
            observation = replace(observation, vertical=vertical(frame, observation.posterior))
            yield frame, observation, 1e3 * (time.perf_counter() - begin)
            before_ns = frame.time_ns

    # An image is read and seen by the network while the filter has the one before.
    with RunOutputs(directory, recording=config.recording, view=config.view, place=place) as outputs:
        with ahead(source) as frames, ahead(observations(frames)) as observed_frames:
            for number, (frame, observation, observe_ms) in enumerate(observed_frames, start=1):
                with _about(frame, source):
                    step = loop.step(observation, observe_ms=observe_ms)
                steps.append(FilterStep.of(observation, step.estimate))
                if storeys is not None:
                    on_storeys.append(storeys.belief(step.estimate))
                outputs.add(frame, step)
                if progress is not None:
                    progress(number, _expected(number, source))
        if source.counts.are_very_few and not allow_few_images:
            raise VaporTrackError(
                f"{source.path}: {source.counts.warning} Expected at least one in ten (--allow-few-images localizes"
                " fewer)"
            )
        look_back = LookBack.on(steps, outputs.times_ns, noise, settings, config.lag) if steps else None
        record = outputs.record(skipped=source.skipped, images=source.counts, look_back=look_back)
    return replace(
        record,
        storeys=storeys,
        storey_belief=None if storeys is None else np.stack(on_storeys),
    )


def _expected(done: int, source: FrameSource | EstimateSequence) -> int:
    """About how many frames there will be: not all images that are read are localized."""
    read, images = source.counts.read, source.num_images
    return round(done * images / read) if 0 < read < images else images


@contextmanager
def _about(frame: Any, source: FrameSource | EstimateSequence) -> Iterator[None]:
    try:
        yield
    except VaporTrackError as error:
        raise VaporTrackError(f"{source.path}: image at {frame.time_ns} ns: {error}") from error
