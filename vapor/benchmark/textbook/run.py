"""One trial: all filters go over it side by side, image after image, each timed.

Processor time: what else the machine does would count as the filter's.
"""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from filtering.se3 import Poses
from sequences.frame import Trajectory
from vapor.benchmark.textbook.building_blocks import TextbookSettings
from vapor.benchmark.textbook.methods import Image, Method, Said, start, versions
from vapor.benchmark.trials.replay import Replay, load_replay, trial_settings
from vapor.benchmark.trials.setup import Setup
from vapor.benchmark.trials.trial import Trial
from vapor.cache import cached, code_digest
from vapor.evaluation.consistency import recovery_images
from vapor.evaluation.trajectory import evaluate_trajectory, is_right

_CODE = "building_blocks", "methods", "run", "with_filterpy", "with_particles"


def run_methods(
    trial: Trial, setup: Setup, methods: Sequence[Method], settings: TextbookSettings, directory: Path
) -> dict[str, Any]:
    """Run all filters over a trial, or take the cached result of a run with the same settings and the same code.

    Args:
        trial: Which; lengths are as recorded.
        setup: With which model and filter of ours.
        methods: The filters.
        settings: Of the textbook filters.
        directory: With `recordings`; results, times among them, are cached in `textbook`.

    Returns:
        JSON: `name`, `scene`, `kind`, `walk`, and of each of the `methods` what `compare_methods` says.

    Raises:
        VaporTrackError: a recording is missing or was made with other settings.
    """
    more = {
        "methods": [method.key for method in methods],
        "textbook": asdict(settings),
        "libraries": versions(),
        "textbook_code": code_digest(*(f"vapor.benchmark.textbook.{name}" for name in _CODE)),
    }
    return cached(
        directory / "textbook" / trial.name,
        json.loads(json.dumps(trial_settings(trial, setup) | more)),
        lambda: {
            "name": trial.name,
            "scene": trial.scene,
            "kind": trial.kind,
            "walk": trial.segments[0].seed,
            "methods": compare_methods(trial, setup, methods, settings, load_replay(trial, setup, directory)),
        },
    )


def compare_methods(
    trial: Trial, setup: Setup, methods: Sequence[Method], settings: TextbookSettings, replay: Replay
) -> dict[str, dict[str, Any]]:
    """What every filter made of a replay, by its key.

    Returns:
        JSON: `step_ms`, processor time from samples to estimate, of every image; median number of `particles`;
        `trajectory`, see `evaluate_trajectory`; fraction of the images that it called `converged`, and of all images
        the fraction `sure_and_wrong`; `recovery_images` where the camera is carried off.
    """
    calibration = setup.checkpoint().calibration
    config, fit = setup.localizer, calibration.odometry
    odometry = replay.odometry
    if fit is not None:
        config = replace(config, slow_errors=fit.slow_errors)
        odometry = tuple(map(fit.restated, odometry))
    first = trial.segments[0]
    steps = {
        method.key: start(
            method, config, calibration.errors, settings, np.random.default_rng([first.seed, first.start])
        )
        for method in methods
    }
    keys = list(steps)
    said: dict[str, list[Said]] = {key: [] for key in keys}
    step_ms: dict[str, list[float]] = {key: [] for key in keys}
    for i, motion in enumerate(odometry):
        image = Image(replay.posterior_poses(i), float(replay.unfamiliarity[i]), motion)
        for key in keys[i % len(keys) :] + keys[: i % len(keys)]:  # nobody always comes after the slowest
            begin = time.process_time()
            said[key].append(steps[key](image))
            step_ms[key].append(round(1e3 * (time.process_time() - begin), 3))
    return {key: {"step_ms": step_ms[key], **_figures(said[key], replay, trial.kidnap_index)} for key in keys}


def _figures(said: Sequence[Said], replay: Replay, kidnap_index: int | None) -> dict[str, Any]:
    best = Poses.stack([each.best for each in said])
    right = is_right(best, replay.truth)
    converged = np.array([each.converged for each in said])
    trajectory = evaluate_trajectory(
        Trajectory(replay.times_ns, best), Trajectory(replay.times_ns, replay.truth), tracking=kidnap_index is None
    )
    return {
        "particles": int(np.median([each.particles for each in said])),
        "trajectory": trajectory,
        "converged": float(converged.mean()),
        "sure_and_wrong": float((converged & ~right).mean()),
        "recovery_images": None if kidnap_index is None else recovery_images(right, kidnap_index=kidnap_index),
    }
