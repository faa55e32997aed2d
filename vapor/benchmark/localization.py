"""`vapor-benchmark localization`: many trials on synthetic scenes, in parallel, and their aggregates."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from filtering.errors import VaporTrackError, require_within
from vapor.benchmark.evaluation import BELIEVING, SUCCESS_M, Walks
from vapor.benchmark.recordings.storage import RecordingSettings
from vapor.benchmark.trials.choose import KINDS, Kind, Trial, choose_trials
from vapor.benchmark.trials.replay import run_trial
from vapor.benchmark.trials.setup import Setup, TrialsConfig, camera_paths, make_recordings, make_setups
from vapor.evaluation.consistency import REGIONS
from vapor.evaluation.trajectory import POSITION_M, THRESHOLDS
from vapor.parallel.jobs import Workers, in_parallel
from vapor.tracking.ablations import ABLATIONS
from vapor.tracking.methods import METHODS


@dataclass(frozen=True)
class LocalizationConfig(TrialsConfig):
    """Settings of a benchmark of localization."""

    kinds: tuple[Kind, ...] = ("cue", "no-cue", "kidnap")
    """What happens in the runs."""
    runs: int = 100
    """Runs of each kind and scene."""
    ablations: tuple[str, ...] = ("full",)
    """Filters to run: the full one, or with a part taken out or changed."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_within(self, runs=(1, 10**6))
        for name, chosen in (("kinds", self.kinds), ("ablations", self.ablations)):
            if not chosen or len(set(chosen)) < len(chosen):
                raise VaporTrackError(f"{name} are {', '.join(chosen) or 'none'}, expected each at most once, and one")
        for ablation in self.ablations:
            if ablation not in ABLATIONS:
                raise VaporTrackError(f"unknown ablation {ablation!r}, expected one of {', '.join(ABLATIONS)}")

    def settings(self) -> dict[str, Any]:
        """All settings as summary.json has them, where ablations are called variants as they always were."""
        return {{"ablations": "variants"}.get(name, name): value for name, value in asdict(self).items()}


class LocalizationBenchmark:
    """The trials of a benchmark and where their results lie.

    Args:
        scenes: Names of scenes, each with the model to localize by: a file, or the name of one that ships.
        directory: For recordings and results; an interrupted benchmark continues where it was.
    """

    def __init__(
        self,
        scenes: Mapping[str, str],
        directory: Path,
        config: LocalizationConfig,
        workers: Workers | None = None,
    ) -> None:
        self.directory = directory
        self.config = config
        self._workers = workers or Workers(config.workers)
        self._setups = make_setups(scenes, config)

    def choose(self, progress: Callable[[int, int], None]) -> list[Trial]:
        """The trials: the same for the same settings."""
        trials: list[Trial] = []
        c = self.config
        for scene, setup in self._setups.items():
            # Runs of two kinds may share recordings, and neighbouring kidnaps do.
            for kind in c.kinds:
                path = camera_paths(setup, scene, kind, self.directory / "recordings")
                trials += choose_trials(scene, kind, runs=c.runs, first_seed=c.first_seed, frames=c.frames, path=path)
                progress(len(trials), len(self._setups) * len(c.kinds) * c.runs)
        return trials

    def record(self, trials: Sequence[Trial]) -> Iterator[tuple[int, int]]:
        """Make the recordings that are missing; yields the number done and the number of all after each."""
        wanted: dict[RecordingSettings, Setup] = {}
        for trial in trials:
            setup = self._setups[trial.scene]
            wanted |= {setup.recording(trial.scene, trial.kind, segment): setup for segment in trial.segments}
        yield from make_recordings(wanted, self.directory / "recordings", self._workers)

    def localize(self, trials: Sequence[Trial]) -> Iterator[dict[str, Any]]:
        """The result of every trial and ablation, in no order; cached ones are not computed again."""
        jobs = [
            (trial, replace(self._setups[trial.scene], ablation=ablation), self.directory)
            for ablation in self.config.ablations
            for trial in trials
        ]
        yield from in_parallel(run_trial, jobs, self._workers)


WITHIN_IMAGES = 50
"""A kidnapped filter should be right again after at most this many images."""

OFTEN = 0.05
"""Fraction of a run's images from which on being confident of a wrong place is more than momentary."""

Results = Sequence[Mapping[str, Any]]


def summarise(results: Results) -> dict[str, dict[str, dict[str, Any]]]:
    """Aggregates of all results, by scene, kind and ablation."""
    groups: dict[tuple[str, str, str], list[Mapping[str, Any]]] = {}
    for result in sorted(results, key=lambda each: each["name"]):
        groups.setdefault((result["scene"], result["kind"], result["variant"]), []).append(result)
    summary: dict[str, dict[str, dict[str, Any]]] = {}
    for (scene, kind, ablation), group in groups.items():
        summary.setdefault(scene, {}).setdefault(kind, {})[ablation] = _aggregate(group)
    return summary


def failed(result: Mapping[str, Any]) -> bool:
    """Whether a run is one to look at.

    With something unique on its way: it did not find itself. Without, or standing: it was confident of a wrong place in
    at least 5 % of its images. Carried off: it did not recover within 50 images.
    """
    like, belief = KINDS[result["kind"]].like, result["belief"]["filter"]
    if like == "cue":
        return not result["methods"]["filter"]["success"]
    return _wrong_fraction(belief) >= OFTEN if like == "no-cue" else not _recovered(belief)


def _aggregate(results: Results) -> dict[str, Any]:
    walks = Walks([result["walk"] for result in results])
    images = [result["images"] for result in results]
    total = {
        "runs": len(results),
        "walks": walks.count,
        "images": sum(images),
        "methods": {name: _method([result["methods"][name] for result in results], walks) for name in METHODS},
        "belief": {name: _belief([result["belief"][name] for result in results], images, walks) for name in BELIEVING},
        "image_truth_among_modes": _mean([result["image_truth_among_modes"] for result in results]),
        "particles": float(np.median([result["particles"] for result in results])),
        "step_ms": float(np.median([result["step_ms"] for result in results])),
        "failed": [result["name"] for result in results if failed(result)],
    }
    if "sequences" in results[0]:
        total["sequences"] = {
            length: _sequences([result["sequences"][length] for result in results], walks)
            for length in results[0]["sequences"]
        }
    return total


def _method(metrics: Results, walks: Walks) -> dict[str, Any]:
    """Recalls are over all images of all runs, which have the same length; errors and times are medians over runs."""
    errors_m = [each["median_translation_m"] for each in metrics]
    recall = {name: [each["recall"][name] for each in metrics] for name in THRESHOLDS}
    position = {name: [each["position_recall"][name] for each in metrics] for name in POSITION_M}
    intervals: dict[str, Any] = {
        "median_translation_m": walks.median(errors_m),
        "recall": {name: walks.mean(fractions) for name, fractions in recall.items()},
        "position_recall": {name: walks.mean(fractions) for name, fractions in position.items()},
    }
    total: dict[str, Any] = {
        "median_translation_m": float(np.median(errors_m)),
        "median_rotation_deg": float(np.median([each["median_rotation_deg"] for each in metrics])),
        "recall": {name: _mean(fractions) for name, fractions in recall.items()},
        "position_recall": {name: _mean(fractions) for name, fractions in position.items()},
        "intervals": intervals,
    }
    if "success" in metrics[0]:
        intervals["successes"] = walks.number([each["success"] for each in metrics])
        after = [each["after_convergence"] for each in metrics if each["success"]]
        images = [each["images"] for each in after]
        total["successes"] = len(after)
        total["converged_at_s"] = _median([each["converged_at_s"] for each in metrics if each["success"]])
        total["recall_after_convergence"] = {
            name: _mean([each["recall"][name] for each in after], images) for name in THRESHOLDS
        }
    if "storey_accuracy" in metrics[0]:
        accuracies = [each["storey_accuracy"] for each in metrics]
        total["storey_accuracy"], intervals["storey_accuracy"] = _mean(accuracies), walks.mean(accuracies)
    if "storey" in metrics[0]:
        total["storey"] = _storey([each["storey"] for each in metrics], walks)
    return total


def _sequences(parts: Results, walks: Walks) -> dict[str, Any]:
    numbers = [part["sequences"] for part in parts]
    names = dict.fromkeys(name for part in parts for name in part["success"] or ())
    success = {
        name: {limit: [part["success"] and part["success"][name][limit] for part in parts] for limit in SUCCESS_M}
        for name in names
    }
    return {
        "sequences": sum(numbers),
        "success": {
            name: {limit: _mean(fractions, numbers) for limit, fractions in each.items()}
            for name, each in success.items()
        },
        "intervals": {
            name: {limit: walks.mean(fractions, numbers) for limit, fractions in each.items()}
            for name, each in success.items()
        },
    }


def _storey(storeys: Results, walks: Walks) -> dict[str, Any]:
    """How many of all images are right but for the storey, and how many are right once the storey is."""
    but_for_it = [storey["but_for_it"] for storey in storeys]
    right, images = [storey["settled_right"] for storey in storeys], [storey["settled_images"] for storey in storeys]
    return {
        "but_for_it": _mean(but_for_it),
        "settled_images": sum(images),
        "settled_right": _mean(right, images),
        "intervals": {"but_for_it": walks.mean(but_for_it), "settled_right": walks.mean(right, images)},
    }


def _belief(beliefs: Results, images: Sequence[int], walks: Walks) -> dict[str, Any]:
    false_recoveries = [belief["false_recoveries"] for belief in beliefs]
    wrong = [_wrong_fraction(belief) for belief in beliefs]
    right = [belief["status"]["converged"] - fraction for belief, fraction in zip(beliefs, wrong, strict=True)]
    total: dict[str, Any] = {
        "status": {
            name: _mean([belief["status"][name] for belief in beliefs], images) for name in beliefs[0]["status"]
        },
        "rightly_converged": _mean(right, images),
        "converged_images": _consistency([belief["converged_images"] for belief in beliefs], walks),
        "after_convergence": _consistency([belief["after_convergence"] for belief in beliefs], walks),
        "truth_among_modes": _mean([belief["truth_among_modes"] for belief in beliefs], images),
        "false_recoveries": sum(false_recoveries),
        "runs_with_false_recovery": sum(number > 0 for number in false_recoveries),
        "runs_wrongly_converged": sum(fraction > 0 for fraction in wrong),
        "runs_wrongly_converged_often": sum(fraction >= OFTEN for fraction in wrong),
        "longest_wrong_s": max(belief["longest_wrong_s"] for belief in beliefs),
        "intervals": {
            "rightly_converged": walks.mean(right, images),
            "runs_wrongly_converged": walks.number([fraction > 0 for fraction in wrong]),
        },
    }
    if "on_storey" in beliefs[0]:
        total["on_storey"] = _consistency([belief["on_storey"] for belief in beliefs], walks)
    kidnaps = [belief["kidnap"] for belief in beliefs if belief["kidnap"] is not None]
    if kidnaps:
        needed = [kidnap["images"] for kidnap in kidnaps if kidnap["images"] is not None]
        in_time = [_recovered(belief) for belief in beliefs]
        total["kidnap"] = {
            "right_before": sum(kidnap["right_before"] for kidnap in kidnaps),
            "recovered_in_time": sum(in_time),
            "recovered": len(needed),
            "median_images": _median(needed),
            "intervals": {"recovered_in_time": walks.number(in_time)},
        }
    return total


def _consistency(parts: Results, walks: Walks) -> dict[str, Any]:
    """Fractions are over all images; the NEES is the median of the runs' medians."""
    images = [part["images"] for part in parts]
    wrong, nees = [part["wrong"] for part in parts], [part["median_nees"] for part in parts]
    coverage = {region: [part["coverage"] and part["coverage"][region] for part in parts] for region in REGIONS}
    return {
        "images": sum(images),
        "wrong": _mean(wrong, images),
        "coverage": {region: _mean(fractions, images) for region, fractions in coverage.items()},
        "median_nees": _median(nees),
        "intervals": {
            "wrong": walks.mean(wrong, images),
            "coverage": {region: walks.mean(fractions, images) for region, fractions in coverage.items()},
            "median_nees": walks.median(nees),
        },
    }


def _wrong_fraction(belief: Mapping[str, Any]) -> float:
    """Fraction of all images of a run that are `converged` and wrong."""
    return belief["status"]["converged"] * (belief["converged_images"]["wrong"] or 0.0)


def _recovered(belief: Mapping[str, Any]) -> bool:
    images = belief["kidnap"]["images"]
    return images is not None and images <= WITHIN_IMAGES


def _mean(values: Sequence[int | float | None], weights: Sequence[int | float] | None = None) -> float | None:
    weights = [1] * len(values) if weights is None else weights
    known = [(value, weight) for value, weight in zip(values, weights, strict=True) if value is not None]
    total = sum(weight for _, weight in known)
    return sum(value * weight for value, weight in known) / total if total else None


def _median(values: Sequence[int | float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.median(known)) if known else None
