"""What the commands of experiments share: progress, and settings as they are written beside results."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from vapor.commands.progress import progress
from vapor.experiments.schedule import ScheduleConfig, ScheduleExperiment
from vapor.experiments.sweep import Sweep, SweepConfig
from vapor.experiments.table import TableConfig, TableExperiment


def render(experiment: Sweep | ScheduleExperiment | TableExperiment) -> None:
    """Render what is missing, with progress."""
    with progress("rendering", "walks") as advance:
        for done, total in experiment.render():
            advance(done, total)


def trained(experiment: Sweep | TableExperiment, total: int) -> Iterator[dict[str, Any]]:
    """Render and train with progress; the result of every training run as it is done."""
    render(experiment)
    with progress("training", "networks") as advance:
        for done, result in enumerate(experiment.train(), start=1):
            yield result
            advance(done, total)


def settings_of(config: SweepConfig | ScheduleConfig | TableConfig, scenes: Sequence[str]) -> dict[str, Any]:
    """All settings of an experiment, as JSON."""
    stored = config.train.as_stored()
    train = {key: str(value) if isinstance(value, Path) else value for key, value in stored.items()}
    return asdict(config) | {"train": train, "scenes": list(scenes)}
