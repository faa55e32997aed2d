"""`vapor-track benchmark`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro
from rich.table import Table

from filtering.errors import VaporTrackError, require_within
from vapor.benchmark import Trial, localize_trials, time_step
from vapor.commands.console import bar, parse, show, usage_error
from vapor.evaluate import REGIONS, THRESHOLDS
from vapor.observation import VaporObservationModel
from vapor.report import write_report
from vapor.run import RunConfig
from vapor.threads import limited_threads

_MAX_SEED = 2**63
_METHODS = ("single_image", "dead_reckoning", "kalman", "filter", "smoothed")


@dataclass(frozen=True)
class StepOptions:
    """Time the parts of a step: decoding, network, filter."""

    model: str = "staircase"
    """Model file, or name of a model that ships with the package."""
    num_samples: int = 1000
    """Posterior samples per image."""
    particles: tuple[int, ...] = (1000, 10000)
    """Sizes of the filter."""
    threads: int = 1
    """Processor threads of the network."""
    repetitions: int = 50
    """Of every part."""
    seed: int = 0
    """Of all random draws."""

    def __post_init__(self) -> None:
        require_within(
            self, **dict.fromkeys(("num_samples", "threads", "repetitions"), (1, 10**6)), seed=(0, _MAX_SEED)
        )
        if not self.particles or min(self.particles) < 1:
            raise VaporTrackError(f"particles are {self.particles}, expected numbers of at least 1")


@dataclass(frozen=True)
class LocalizationOptions:
    """Localize many synthetic sequences, and count successes."""

    scene: tyro.conf.Positional[Literal["staircase", "ceiling"]]
    """What the camera moves through."""
    output: Path
    """Directory for sequences, runs and summary.json; an interrupted benchmark of the same output goes on."""
    model: str | None = None
    """Model file, or name of a model that ships. Default: the scene's name."""
    seeds: int = 10
    """Number of sequences."""
    first_seed: int = 1000
    """Their seeds count up from here."""
    frames: int = 300
    """Images of each sequence."""
    workers: int = 2
    """Sequences at a time."""
    config: Annotated[RunConfig, tyro.conf.arg(name="")] = field(default_factory=lambda: RunConfig(recording=False))

    def __post_init__(self) -> None:
        require_within(self, **dict.fromkeys(("seeds", "frames", "workers"), (1, 10**6)), first_seed=(0, _MAX_SEED))


_OPTIONS = {"step": StepOptions, "localization": LocalizationOptions}


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    kinds = {"step": _step, "localization": _localization}
    if arguments[:1] in (["-h"], ["--help"]):
        show("usage: vapor-track benchmark step|localization ...\n\nMeasure; each of the two has its own --help.\n")
        show("\n".join(f"  {kind:<13} {options.__doc__}" for kind, options in _OPTIONS.items()))
        return
    if not arguments or arguments[0] not in kinds:
        usage_error("benchmark", f"expected one of {', '.join(kinds)} first")
    kinds[arguments[0]](arguments[1:])


def _step(arguments: Sequence[str]) -> None:
    o = parse("benchmark step", StepOptions, arguments)
    model = VaporObservationModel.from_checkpoint(o.model, num_samples=o.num_samples)
    table = Table("part of a step", "median ms", "95 % ms")
    with limited_threads(o.threads):
        timings = time_step(model, repetitions=o.repetitions, particles=o.particles, seed=o.seed)
    for timing in timings:
        table.add_row(timing.part, f"{timing.median_ms:.2f}", f"{timing.p95_ms:.2f}")
    show(table)


def _localization(arguments: Sequence[str]) -> None:
    o = parse("benchmark localization", LocalizationOptions, arguments)
    seeds = range(o.first_seed, o.first_seed + o.seeds)
    trials = [Trial(o.scene, seed, o.frames, o.model or o.scene) for seed in seeds]
    o.output.mkdir(parents=True, exist_ok=True)
    reports = []
    with bar("localizing sequences") as advance:
        for report in localize_trials(trials, o.output, o.config, workers=o.workers):
            reports.append(report)
            advance(len(reports), len(trials))
    reports.sort(key=lambda report: report["seed"])
    write_report(o.output / "summary.json", {"scene": o.scene, "runs": reports})
    show(_runs_table(reports))
    show(_methods_table(reports))
    show(_consistency_table(reports))


def _runs_table(reports: Sequence[Mapping[str, Any]]) -> Table:
    table = Table("seed", "single image right", "filter right", "smoothed right", "converged at", "success")
    for report in reports:
        right = [
            f"{100 * report[name]['recall']['0.3m/20deg']:.0f} %" for name in ("single_image", "filter", "smoothed")
        ]
        at_s = report["filter"]["converged_at_s"]
        table.add_row(
            str(report["seed"]),
            *right,
            "–" if at_s is None else f"{at_s:.1f} s",
            "yes" if report["filter"]["success"] else "no",
        )
    return table


def _methods_table(reports: Sequence[Mapping[str, Any]]) -> Table:
    table = Table("all runs", "success", "median error", *(f"within {name}" for name in THRESHOLDS))
    for method in _METHODS:
        metrics = [report[method] for report in reports]
        recalls = [f"{100 * np.mean([m['recall'][name] for m in metrics]):.0f} %" for name in THRESHOLDS]
        successes = sum(m["success"] for m in metrics) if "success" in metrics[0] else None
        median_m = np.median([m["median_translation_m"] for m in metrics])
        table.add_row(
            method.replace("_", " "),
            "" if successes is None else f"{successes} of {len(reports)}",
            f"{median_m:.2f} m",
            *recalls,
        )
    return table


def _consistency_table(reports: Sequence[Mapping[str, Any]]) -> Table:
    """Over all images of all runs that the filter calls converged."""
    said = [report["consistency"] for report in reports if report["consistency"]["images"]]
    images = sum(each["images"] for each in said)
    table = Table("said converged", "wrong by 0.5 m", *(f"in the {region} region" for region in REGIONS), "median NEES")
    if not said:
        table.add_row("0 images", *[""] * (len(REGIONS) + 2))
        return table
    share = np.array([each["images"] / images for each in said])
    figures = [[each["wrong"], *(each["coverage"][region] for region in REGIONS)] for each in said]
    nees = np.median([each["median_nees"] for each in said])
    table.add_row(
        f"{images} images",
        *(f"{100 * value:.1f} %" for value in share @ np.array(figures)),
        f"{nees:.1f} (5.3 is true)",
    )
    return table
