"""One trial of a benchmark: every method over the same recorded posteriors, and how well each did."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from filtering.floors import Floors
from sequences.scenes import find_scene
from vapor.benchmark.evaluation.comparison import compare
from vapor.benchmark.evaluation.sequential import evaluate_sequences
from vapor.benchmark.trials.kinds import KINDS
from vapor.benchmark.trials.replay import Replay, follow_trial, load_replay, trial_settings
from vapor.benchmark.trials.setup import Setup
from vapor.benchmark.trials.trial import Trial
from vapor.cache import cached
from vapor.tracking.ablations import ABLATIONS


def run_trial(trial: Trial, setup: Setup, directory: Path) -> dict[str, Any]:
    """Run a trial, or take the cached result of a run with the same settings and the same code.

    Args:
        trial: Which.
        setup: With which model and filter.
        directory: With `recordings`; results are cached in `trials`.

    Returns:
        JSON: `name`, `scene`, `kind`, `walk` (the seed of the first segment), `variant` (the ablation), `cue_images`,
        what `Comparison.figures` gives, and `sequences`, see `evaluate_sequences`, where the kind has them.

    Raises:
        VaporTrackError: a recording is missing or was made with other settings.
    """
    return cached(
        directory / "trials" / f"{trial.name}-{setup.ablation}",
        trial_settings(trial, setup),
        lambda: localize(trial, setup, load_replay(trial, setup, directory)),
    )


def localize(trial: Trial, setup: Setup, replay: Replay) -> dict[str, Any]:
    """The result of a trial, see `run_trial`, from what the methods are given of it."""
    # Evaluated in the lengths of the scene: what is right is so at any scale.
    followed = follow_trial(trial, setup, replay)
    compared = compare(followed).scaled(1.0 / trial.scale)
    first, kind = trial.segments[0], KINDS[trial.kind]
    sequences = {}
    if kind.in_sequences:
        ablation = ABLATIONS[setup.ablation]
        sequences["sequences"] = evaluate_sequences(
            followed, seed=(first.seed, first.start), unit_m=trial.scale, ablation=ablation
        )
    return {
        "name": trial.name,
        "scene": trial.scene,
        "kind": trial.kind,
        "walk": first.seed,
        "variant": setup.ablation,
        "cue_images": replay.cue_images,
        **compared.figures(
            floor_height_m=find_scene(trial.scene).floor_height_m,
            floors=Floors.found_in(setup.checkpoint().prior_poses),
        ),
        **sequences,
    }
