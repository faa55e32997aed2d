"""The runs of `benchmark localization`, each with all filters side by side."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from filtering.errors import VaporTrackError, require_within
from vapor.benchmark.localization.benchmark import LocalizationBenchmark, LocalizationConfig
from vapor.benchmark.textbook.building_blocks import TextbookSettings
from vapor.benchmark.textbook.methods import OURS, TEXTBOOK, Method, installed
from vapor.benchmark.textbook.run import run_methods
from vapor.benchmark.trials.kinds import KINDS, Kind
from vapor.benchmark.trials.setup import TrialsConfig, make_setups
from vapor.benchmark.trials.trial import Trial
from vapor.parallel.jobs import Workers, in_parallel


@dataclass(frozen=True)
class TextbookConfig(TrialsConfig):
    """Settings of a benchmark against textbook filters."""

    workers: int = 1
    """Processes at a time, each with one thread: several disturb each other's times."""
    kinds: tuple[Kind, ...] = ("cue",)
    """What happens in the runs."""
    runs: int = 100
    """Runs of each kind and scene."""
    methods: tuple[str, ...] = TEXTBOOK
    """Textbook filters to run beside ours."""
    particles: tuple[int, ...] = (1000, 10000)
    """Numbers of their particles."""
    equal_runs: int = 3
    """So many runs of each kind and scene with ours as well at as many hypotheses, none merged or dropped: slow."""
    textbook: TextbookSettings = field(default_factory=TextbookSettings)
    """The textbook filters."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_within(self, runs=(1, 10**6), equal_runs=(0, 10**6))
        for name, chosen in (("kinds", self.kinds), ("methods", self.methods), ("particles", self.particles)):
            if not chosen or len(set(chosen)) < len(chosen):
                listed = ", ".join(map(str, chosen)) or "none"
                raise VaporTrackError(f"{name} are {listed}, expected each at most once, and one")
        for name in self.methods:
            if name not in TEXTBOOK:
                raise VaporTrackError(f"unknown textbook filter {name!r}, expected one of {', '.join(TEXTBOOK)}")
        if not all(1 <= count <= 10**6 for count in self.particles):
            raise VaporTrackError(f"particles are {self.particles}, expected numbers between 1 and 1000000")
        for kind in self.kinds:
            if KINDS[kind].scale != 1.0:
                raise VaporTrackError(
                    f"kind is {kind}, expected one of unchanged lengths: textbook filters have metres"
                )


class TextbookBenchmark:
    """The trials of a benchmark, those of `LocalizationBenchmark` and from its recordings, and where results lie.

    Args:
        scenes: Names of scenes, each with the model to localize by: a file, or the name of one that ships.
        directory: For recordings and results; an interrupted benchmark continues where it was.
        config: Settings.
        errors: What replaces numbers of the models' own error models, by name.
        workers: Where jobs are done; None for as many processes here as configured.
    """

    def __init__(
        self,
        scenes: Mapping[str, str],
        directory: Path,
        config: TextbookConfig,
        errors: Mapping[str, Any],
        workers: Workers | None = None,
    ) -> None:
        self.directory = directory
        self.config = config
        self._workers = workers or Workers(config.workers)
        self._setups = make_setups(scenes, config, errors)
        shared = {each.name: getattr(config, each.name) for each in fields(TrialsConfig)}
        like = LocalizationConfig(**shared, kinds=config.kinds, runs=config.runs)
        self._localization = LocalizationBenchmark(scenes, directory, like, errors, self._workers)

    def choose(self, progress: Callable[[int, int], None]) -> list[Trial]:
        """The trials: the same for the same settings."""
        return self._localization.choose(progress)

    def record(self, trials: Sequence[Trial]) -> Iterator[tuple[int, int]]:
        """Make the recordings that are missing; yields the number done and the number of all after each."""
        yield from self._localization.record(trials)

    def compare(self, trials: Sequence[Trial]) -> Iterator[dict[str, Any]]:
        """The result of every trial, in no order; cached ones are not computed again."""
        jobs = []
        of_group: dict[tuple[str, str], int] = {}
        for trial in trials:
            group = trial.scene, trial.kind
            of_group[group] = before = of_group.get(group, -1) + 1
            methods = self.methods(equal=before < self.config.equal_runs)
            jobs.append((trial, self._setups[trial.scene], methods, self.config.textbook, self.directory))
        yield from in_parallel(run_methods, jobs, self._workers)

    def methods(self, *, equal: bool) -> list[Method]:
        """The filters of a trial; those of which the library is missing are left out."""
        here = [name for name in self.config.methods if name in installed()]
        names = [*([OURS] if equal else []), *here]
        return [Method(OURS), *(Method(name, count) for name in names for count in self.config.particles)]
