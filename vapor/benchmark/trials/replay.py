"""Trials cut from recordings, and every method run over them and evaluated."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int64

from filtering.motion import Odometry
from filtering.se3 import Poses
from filtering.storeys import Storeys
from sequences.scenes import find_scene
from vapor.benchmark.evaluation import all_poses, evaluate_methods, evaluate_sequences
from vapor.benchmark.recordings.storage import Observed, Recording, load_recording
from vapor.benchmark.trials.choose import KINDS, Excerpt, Trial
from vapor.benchmark.trials.setup import Setup
from vapor.cache import cached
from vapor.tracking.ablations import ABLATIONS
from vapor.tracking.follow import Followed, Segment, follow


@dataclass(frozen=True)
class Replay:
    """The input of the methods of a trial, n images.

    Attributes:
        times_ns: Stamps (n,), without a break.
        odometry: Camera motion since the previous image, (n,).
        truth: True poses, batch (n,).
        observed: Answers of network and landmarks to an image, by its number.
        cue_images: Number of images that show something unique.
    """

    times_ns: Int64[np.ndarray, " n"]
    odometry: tuple[Odometry, ...]
    truth: Poses
    observed: Callable[[int], Observed]
    cue_images: int = 0

    @staticmethod
    def of(recording: Recording) -> Replay:
        """All of a recording."""
        seen = int(recording.path.sees_cue.sum())
        return Replay(recording.times_ns, recording.motions, recording.path.world_from_camera, recording.observed, seen)


def assemble(trial: Trial, recording: Callable[[Excerpt], Recording]) -> Replay:
    """Cut a trial from its recordings, segment by segment.

    Where the camera is carried off, stamps and odometry continue as if it had not been.
    """
    sources = [(recording(segment), segment) for segment in trial.segments]
    first, begin = sources[0][0], trial.segments[0].start
    images = [(source, segment.start + i, i) for source, segment in sources for i in range(segment.length)]
    odometry = []
    for position, (source, image, since_start) in enumerate(images):
        carried = position > 0 and since_start == 0
        odometry.append(first.motion(begin + position) if carried else source.motion(image))
    step_ns = int(first.times_ns[1] - first.times_ns[0]) if len(first.times_ns) > 1 else 0
    seen = np.arange(0, len(images), trial.stride)
    parts = [odometry[max(end - trial.stride, 0) + 1 : end + 1] for end in seen.tolist()]
    parts[0] = [odometry[0]]
    paths = [(source.path, slice(each.start, each.start + each.length)) for source, each in sources]
    sees_cue = np.concatenate([path.sees_cue[part] for path, part in paths])

    def observed(position: int) -> Observed:
        source, image, _ = images[seen[position]]
        return source.observed(image)

    return Replay(
        first.times_ns[begin] + step_ns * seen,
        tuple(reduce(Odometry.then, part) for part in parts),
        Poses.concatenate([path.world_from_camera[part] for path, part in paths])[seen],
        observed,
        int(sees_cue[seen].sum()),
    )


def load_replay(trial: Trial, setup: Setup, directory: Path) -> Replay:
    """A trial as its recordings in `directory / "recordings"` have it.

    Raises:
        VaporTrackError: a recording is missing or was made with other settings.
    """
    return assemble(
        trial,
        lambda segment: load_recording(setup.recording(trial.scene, trial.kind, segment), directory / "recordings"),
    )


def follow_trial(trial: Trial, setup: Setup, replay: Replay) -> Followed:
    """Let filter and baselines follow a trial's replay."""
    first = trial.segments[0]
    return follow_replay(replay, setup, seed=(first.seed, first.start), kidnap_index=trial.kidnap_index)


def follow_replay(replay: Replay, setup: Setup, *, seed: Sequence[int], kidnap_index: int | None = None) -> Followed:
    """Let filter and baselines follow a replay; a camera that is carried off is elsewhere from `kidnap_index` on."""
    checkpoint = setup.checkpoint()
    calibration = checkpoint.calibration
    ablation = ABLATIONS[setup.ablation]
    noise, fit = ablation.noise(calibration.errors), calibration.odometry
    config = ablation.localizer(setup.config.localizer)
    if fit is not None:
        config = replace(config, odometry_bias=fit.odometry_bias)
    segment = Segment(
        replay.times_ns,
        replay.odometry,
        replay.truth,
        lambda image: replay.observed(image).posterior(checkpoint, noise),
    ).restated(fit)
    return follow(segment, noise, config, rng=np.random.default_rng(seed), ablation=ablation, kidnap_index=kidnap_index)


def trial_settings(trial: Trial, setup: Setup) -> dict[str, Any]:
    """Everything that a trial's result depends on, as JSON."""
    recordings = [setup.recording(trial.scene, trial.kind, segment).name for segment in trial.segments]
    return json.loads(json.dumps(asdict(trial) | setup.settings() | {"recordings": recordings}))


def run_trial(trial: Trial, setup: Setup, directory: Path) -> dict[str, Any]:
    """Run a trial unless its result is cached in `directory / "trials"`; recordings lie in `directory / "recordings"`.

    Returns:
        JSON: `name`, `scene`, `kind`, `walk` (the seed of the first segment), `variant` (the ablation), `cue_images`,
        what `evaluate_methods` gives, and `sequences`, see `evaluate_sequences`, where the kind has them.

    Raises:
        VaporTrackError: a recording is missing or was made with other settings.
    """
    return cached(
        directory / "trials" / f"{trial.name}-{setup.ablation}",
        trial_settings(trial, setup),
        lambda: localize(trial, setup, load_replay(trial, setup, directory)),
    )


def localize(trial: Trial, setup: Setup, replay: Replay) -> dict[str, Any]:
    """The result of a trial, see `run_trial`, from the input of the methods."""
    followed = follow_trial(trial, setup, replay)
    first, kind = trial.segments[0], KINDS[trial.kind]
    sequences = {}
    if kind.in_sequences:
        ablation = ABLATIONS[setup.ablation]
        sequences["sequences"] = evaluate_sequences(followed, seed=(first.seed, first.start), ablation=ablation)
    return {
        "name": trial.name,
        "scene": trial.scene,
        "kind": trial.kind,
        "walk": first.seed,
        "variant": setup.ablation,
        "cue_images": replay.cue_images,
        **evaluate_methods(
            followed,
            all_poses(followed),
            storey_height_m=find_scene(trial.scene).storey_height_m,
            storeys=Storeys.found_in(setup.checkpoint().prior_poses),
        ),
        **sequences,
    }
