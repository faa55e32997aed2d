"""Many trials, in parallel, each run once: which there are, their recordings, and their results."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from filtering.errors import VaporTrackError, require_within
from vapor.benchmark.recordings.settings import RecordingSettings
from vapor.benchmark.trials.kinds import Kind
from vapor.benchmark.trials.landmarks_in_view import choose_trials
from vapor.benchmark.trials.recording_jobs import camera_paths, make_recordings
from vapor.benchmark.trials.run import run_trial
from vapor.benchmark.trials.setup import Setup, TrialsConfig, make_setups
from vapor.benchmark.trials.trial import Trial
from vapor.parallel.jobs import Workers, in_parallel
from vapor.tracking.ablations import ABLATIONS


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
        config: Settings.
        workers: Where jobs are done; None for as many processes here as configured.
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
