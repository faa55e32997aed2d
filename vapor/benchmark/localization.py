"""Many runs, in parallel, each done once: which trials, their recordings, their results, and what these add up to."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

from filtering.errors import VaporTrackError, require_within
from filtering.localizer import LocalizerConfig
from vapor.benchmark.recordings import CameraPath, RecordingSettings, camera_path, make_recording
from vapor.benchmark.trials import Setup, run_trial
from vapor.benchmark.windows import Kind, Trial, choose_trials
from vapor.checkpoints.file_format import load_checkpoint
from vapor.checkpoints.shipped_models import find_model
from vapor.parallel import in_parallel
from vapor.tracking.ablations import VARIANTS

_MAX_SEED = 2**62


@dataclass(frozen=True)
class RecordingsConfig:
    """Settings of a benchmark that replays recordings, the same for all its scenes."""

    first_seed: int = 2000
    """Seeds of the sequences count up from here."""
    frames: int = 300
    """Images of each run."""
    width: int = 240
    """Image width in pixels."""
    height: int = 180
    """Image height in pixels."""
    odometry_scale: float | None = None
    """Error of the odometry's distances in place of a random one for each recording, as a share of them: at 0.02 it is
    2 % too long."""
    num_samples: int = 1000
    """Posterior samples per image."""
    workers: int = 2
    """Processes at a time, each with one thread."""
    localizer: LocalizerConfig = field(default_factory=LocalizerConfig)
    """The particle filter."""

    def __post_init__(self) -> None:
        require_within(
            self,
            **dict.fromkeys(("frames", "workers", "num_samples"), (1, 10**6)),
            **dict.fromkeys(("width", "height"), (8, 10**5)),
            first_seed=(0, _MAX_SEED),
        )
        if self.odometry_scale is not None:
            require_within(self, odometry_scale=(-1.0, 10.0))
        if self.frames < 50:
            raise VaporTrackError(f"frames is {self.frames}, expected at least 50: half a second is a tenth of them")


@dataclass(frozen=True)
class BenchmarkConfig(RecordingsConfig):
    """Settings of a benchmark of localization."""

    kinds: tuple[Kind, ...] = ("cue", "no-cue", "kidnap")
    """Runs that pass something unique in their first half, that never do, or in which the camera is carried off to
    where it soon sees something unique; whole walks, no two from one recording, that pass something unique early; the
    same walks at 3, 10 and 30 images a second; those of cue with all lengths multiplied; a camera that stands for five
    minutes, with nothing or something unique in sight, at 10 or 30 images a second."""
    runs: int = 100
    """Runs of each kind and scene."""
    variants: tuple[str, ...] = ("full",)
    """Filters to run: full, or without a part: no-lasting-errors, no-tails, no-adaptation, trusting-shares,
    no-slow-errors, no-injection; inject-on-doubt, as AMCL does; or told-of-kidnap, which starts anew where it was
    carried to."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_within(self, runs=(1, 10**6))
        for name, chosen in (("kinds", self.kinds), ("variants", self.variants)):
            if not chosen or len(set(chosen)) < len(chosen):
                raise VaporTrackError(f"{name} are {', '.join(chosen) or 'none'}, expected each at most once, and one")
        for variant in self.variants:
            if variant not in VARIANTS:
                raise VaporTrackError(f"unknown variant {variant!r}, expected one of {', '.join(VARIANTS)}")


class Benchmark:
    """The trials of a benchmark and where their results lie.

    Args:
        scenes: Names of scenes, each with the model to localize by: a file, or the name of one that ships.
        directory: For recordings and results; one that is interrupted goes on where it was.
        config: Settings.
        errors: What replaces numbers of the models' own error models, by name.
    """

    def __init__(
        self, scenes: Mapping[str, str], directory: Path, config: BenchmarkConfig, errors: Mapping[str, Any]
    ) -> None:
        self.directory = directory
        self.config = config
        self._setups = make_setups(scenes, config, errors)

    def choose(self, progress: Callable[[int, int], None]) -> list[Trial]:
        """The trials: the same for the same settings."""
        trials: list[Trial] = []
        c = self.config
        for scene, setup in self._setups.items():
            # Runs of two kinds may share recordings, and neighbouring kidnaps do.
            for kind in c.kinds:
                path = paths(setup, scene, kind, self.directory / "recordings")
                trials += choose_trials(scene, kind, runs=c.runs, first_seed=c.first_seed, frames=c.frames, path=path)
                progress(len(trials), len(self._setups) * len(c.kinds) * c.runs)
        return trials

    def record(self, trials: Sequence[Trial]) -> Iterator[tuple[int, int]]:
        """Make the recordings that are missing; yields the number done and the number of all after each."""
        wanted: dict[RecordingSettings, Setup] = {}
        for trial in trials:
            setup = self._setups[trial.scene]
            wanted |= {setup.recording(trial.scene, trial.kind, piece): setup for piece in trial.pieces}
        yield from make_recordings(wanted, self.directory / "recordings", self.config.workers)

    def localize(self, trials: Sequence[Trial]) -> Iterator[dict[str, Any]]:
        """The result of every trial and variant, in no order; those that are there are not computed again."""
        jobs = [
            (trial, replace(self._setups[trial.scene], variant=variant), self.directory)
            for variant in self.config.variants
            for trial in trials
        ]
        yield from in_parallel(run_trial, jobs, self.config.workers)


def make_setups(scenes: Mapping[str, str], config: RecordingsConfig, errors: Mapping[str, Any]) -> dict[str, Setup]:
    """What the runs of each scene depend on.

    Args:
        scenes: Names of scenes, each with the model to localize by: a file, or the name of one that ships.
        config: Settings.
        errors: What replaces numbers of the models' own error models, by name.

    Raises:
        VaporTrackError: a model or an error model that cannot be used.
    """
    images = config.frames, config.width, config.height
    setups = {}
    for scene, name in scenes.items():
        model = find_model(name)
        sha256 = hashlib.sha256(model.read_bytes()).hexdigest()
        network_sha256 = load_checkpoint(model).seen_sha256()
        setups[scene] = Setup(
            model,
            sha256,
            network_sha256,
            *images,
            config.num_samples,
            config.localizer,
            errors,
            odometry_scale=config.odometry_scale,
        )
        setups[scene].checkpoint()  # refuses an unusable error model before anything is rendered
    return setups


def make_recordings(
    wanted: Mapping[RecordingSettings, Setup], directory: Path, workers: int
) -> Iterator[tuple[int, int]]:
    """Make the recordings that are missing; yields the number done and the number of all after each."""
    missing = [each for each in wanted.items() if not (directory / each[0].name).is_dir()]
    jobs = [(settings, setup, directory) for settings, setup in missing]
    for done, _ in enumerate(in_parallel(_make, jobs, workers), len(wanted) - len(jobs) + 1):
        yield done, len(wanted)


def paths(setup: Setup, scene: str, kind: Kind, directory: Path) -> Callable[[int], CameraPath]:
    """The walks that trials of a kind are cut from, by seed; each is looked at once."""
    return cache(lambda seed: camera_path(setup.walk(scene, kind, seed), directory))


def _make(settings: RecordingSettings, setup: Setup, directory: Path) -> None:
    make_recording(settings, setup.checkpoint(), directory)
