"""The filter and its baselines over a passage: what each believed, and the poses of every method."""

from __future__ import annotations

import time
from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from filtering.config import LocalizerConfig
from filtering.error_model import ErrorModel
from filtering.estimate import Estimate, Mode
from filtering.se3 import Poses
from vapor.tracking.ablations import ABLATIONS, Ablation
from vapor.tracking.belief import Belief, mode_status
from vapor.tracking.history import History
from vapor.tracking.loop import StepLoop
from vapor.tracking.methods import BASELINES, poses_at_end, start_baselines
from vapor.tracking.passage import Passage


@dataclass(frozen=True)
class Followed:
    """What filter and baselines made of a passage of n images, one image after the other.

    Attributes:
        passage: What they were given.
        errors: How its images err.
        config: Settings of the filter.
        beliefs: What the filter believed, and the baselines that were asked for, by name.
        image_modes: Places of each image's posterior alone, (n,).
        history: What methods need that see the whole passage at once.
        particles: Median number of particles of the filter.
        step_ms: Median milliseconds of a step of the filter.
        kidnap_index: First image after the camera was carried off; None where it was not.
    """

    passage: Passage
    errors: ErrorModel
    config: LocalizerConfig
    beliefs: dict[str, Belief]
    image_modes: tuple[tuple[Mode, ...], ...]
    history: History
    particles: int
    step_ms: float
    kidnap_index: int | None

    @cached_property
    def poses(self) -> dict[str, Poses]:
        """Poses of every method that goes from image to image, by name, world_from_camera, batches (n,)."""
        return {
            "single_image": Poses.stack([modes[0].world_from_camera for modes in self.image_modes]),
            "dead_reckoning": self.passage.dead_reckoning,
            **{name: belief.best for name, belief in self.beliefs.items()},
        }

    def poses_at_end(self) -> dict[str, Poses]:
        """Poses of every method that sees the whole passage at once, by name, world_from_camera, batches (n,)."""
        return poses_at_end(self.history, self.errors, self.config)


def follow(
    passage: Passage,
    errors: ErrorModel,
    config: LocalizerConfig,
    *,
    rng: np.random.Generator,
    ablation: Ablation = ABLATIONS["full"],
    kidnap_index: int | None = None,
    baselines: Collection[str] = BASELINES,
) -> Followed:
    """Localize a passage by filter and baselines, each with the same errors and the same odometry.

    Args:
        passage: Its first image has a place.
        errors: How its images err.
        config: Settings of the filter; its slow errors and gaps are those of all methods.
        rng: Source of all random draws.
        ablation: What is different about the filter. What it changes in `errors` and `config` the caller has changed
            already, as that concerns all methods.
        kidnap_index: First image after the camera was carried off; None where it was not.
        baselines: Names of those to run; a Gaussian sum takes as long as the filter.

    Raises:
        VaporTrackError: unusable odometry or posteriors.
    """
    localizer = ablation.start(config, rng=rng, kidnap_index=kidnap_index)
    loop = StepLoop(localizer, start_baselines(config, lambda: rng, only=baselines))
    history = History()
    estimates: list[Estimate] = []
    image_modes: list[tuple[Mode, ...]] = []
    of_baselines: dict[str, list[tuple[Mode, ...]]] = {}
    step_ms: list[float] = []
    for i, (time_ns, odometry) in enumerate(zip(passage.times_ns.tolist(), passage.odometry, strict=True)):
        begin = time.perf_counter()
        posterior = passage.posterior(i)
        step = loop.step(time_ns, posterior, odometry, observe_ms=1e3 * (time.perf_counter() - begin))
        history.add(step, odometry)
        estimates.append(step.estimate)
        image_modes.append(step.image_modes)
        for name, modes in step.baselines.items():
            of_baselines.setdefault(name, []).append(modes)
        step_ms.append(step.step_ms)
    widest_m = config.widest_std_m(errors)
    beliefs = {
        name: Belief(modes, [mode_status(each[0], widest_m, config.converged_weight) for each in modes])
        for name, modes in of_baselines.items()
    }
    beliefs["filter"] = Belief([each.modes for each in estimates], [each.status for each in estimates])
    return Followed(
        passage,
        errors,
        config,
        beliefs,
        tuple(image_modes),
        history,
        int(np.median([len(each.particles) for each in estimates])),
        float(np.median(step_ms)),
        kidnap_index,
    )
