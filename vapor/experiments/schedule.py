"""What the default schedule saves against the paper's: images and time until it is as good on held-out images.

A schedule is here all of a training but its data, network, α and unit of positions: the paper's differs from the
default in rate and its decay, batches of 4 instead of 32, 1000 samples an image instead of 256, crops, arithmetic
(float32), and in neither averaging weights nor decaying them.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from filtering.errors import VaporTrackError, require_within
from sequences.atomic import atomic_output, workspace
from sequences.files.structured import read_json
from vapor.cache import digest
from vapor.engines.device import resolve_device
from vapor.experiments.scenes import Scene, identities, render_scenes, rendered_height
from vapor.experiments.training_runs import trained_from
from vapor.parallel.jobs import Workers
from vapor.training.config import TrainConfig
from vapor.training.presets import PRESETS
from vapor.training.progress import Progress
from vapor.training.train import train

DEFAULT, PAPER = SCHEDULES = "default", "paper"
_START = "network", "pretrained_weights", "pretrained", "initial_model", "initial_log_variance"
_SHARED = (
    *_START,
    "bandwidth_translation_m",
    "bandwidth_rotation_rad",
    "calibrate",
    "validation_images",
    "seed",
    "device",
)


@dataclass(frozen=True)
class ScheduleConfig:
    """Settings of the experiment."""

    sequences: int = 10
    """Sequences that are trained on."""
    frames: int = 500
    """Images of each."""
    validation_frames: int = 500
    """Images of the sequence that is held out."""
    most: float = 6.0
    """The paper's schedule is given up after so many times the time that the default one takes to its best epoch."""
    seed: int = 0
    """Of both training runs."""
    workers: int = 2
    """Sequences that are rendered at a time."""
    train: TrainConfig = field(default_factory=TrainConfig)
    """The default schedule, and the network, its first weights, α and unit of positions of both."""

    def __post_init__(self) -> None:
        counts = dict.fromkeys(("sequences", "frames", "validation_frames", "workers"), (1, 10**6))
        require_within(self, most=(0.0, 1e6), seed=(0, 10**9), **counts)

    def of(self, schedule: str) -> TrainConfig:
        """How one of the two trains; the paper's settings are those for synthetic scenes."""
        mine = replace(self.train, calibrate=False, validation_images=self.validation_frames, seed=self.seed)
        if schedule == DEFAULT:
            return mine
        paper = PRESETS["paper-synthetic"]
        loss = replace(paper.loss, alpha=mine.loss.alpha, position_unit=mine.loss.position_unit)
        return replace(paper, loss=loss, **{name: getattr(mine, name) for name in _SHARED})


@dataclass(frozen=True)
class Point:
    """Where a training stood after an epoch.

    Attributes:
        images: Seen so far.
        seconds: Of training so far, wall clock, without reading and evaluation.
        recall: Fraction of the posterior samples of held-out images within 0.3 m and 20° of the true pose.
    """

    images: int
    seconds: float
    recall: float


class EnoughError(Exception):
    """Ends a training from within: what was asked for is known."""


class ScheduleExperiment:
    """Two training runs on one scene, one after the other; what is done is not done again.

    Args:
        scene: Name of a synthetic scene.
        directory: For images and results.
        config: Settings.
    """

    def __init__(self, scene: str, directory: Path, config: ScheduleConfig) -> None:
        self.directory, self.config = directory, config
        self._name = scene
        self._scene: Scene | None = None

    def render(self) -> Iterator[tuple[int, int]]:
        """Render the images that are missing; yields the number of sequences done and of all."""
        c = self.config
        for done, total, scenes in render_scenes(
            (self._name,),
            self.directory,
            train_walks=c.sequences,
            train_frames=c.frames,
            test_walks=1,
            test_frames=c.validation_frames,
            height=rendered_height(c.train.network.frame_size),
            workers=Workers(c.workers),
        ):
            (self._scene,) = scenes
            yield done, total

    def train(self, schedule: str, advance: Callable[[int, int], None]) -> list[Point]:
        """The course of a training, epoch by epoch.

        The paper's, which needs that of the default one, ends where it is as good as the latter's best epoch, or takes
        `most` times as long.

        Args:
            schedule: Which of `SCHEDULES`.
            advance: Called after every step with the number of steps done and of all.
        """
        if schedule == DEFAULT:
            return self._course(DEFAULT, None, None, advance)
        best = max(self.train(DEFAULT, advance), key=lambda point: point.recall)
        return self._course(PAPER, best.recall, self.config.most * best.seconds, advance)

    def _course(
        self, schedule: str, enough: float | None, most_s: float | None, advance: Callable[[int, int], None]
    ) -> list[Point]:
        if self._scene is None:
            raise RuntimeError("train before render")
        config = self.config.of(schedule)
        folder = self.directory / "runs"
        folder.mkdir(parents=True, exist_ok=True)
        evaluated = {"test": identities(self._scene.test), "enough": enough, "most_s": most_s}
        where = {"device": str(resolve_device(config.device))}  # seconds depend on it
        content = digest(trained_from(self._scene, config) | evaluated | where)
        file = folder / f"{self._name}-{schedule}-{content}.json"
        if file.is_file():
            return [Point(**point) for point in read_json(file)]
        batch_size = min(config.batch_size, self.config.sequences * self.config.frames)
        clock = Clock(batch_size, enough, most_s, advance)
        with workspace(folder, file.name) as work, contextlib.suppress(EnoughError):
            model = work / "model.safetensors"
            result = train(self._scene.train, model, config, validation=self._scene.test, progress=clock.follow)
            if not result.history:
                raise VaporTrackError(f"{self._name}: {'; '.join(result.checkpoint.training['holding_out'])}")
            clock.evaluated(result.history[-1].sample_recall)
        with atomic_output(file) as partial:
            partial.write_text(json.dumps([asdict(point) for point in clock.course]), encoding="utf-8")
        return clock.course


class Clock:
    """Follows a training by its progress, and ends it.

    Args:
        batch_size: Images per step.
        enough: Recall with which it ends.
        most_s: Seconds after which it ends.
        advance: Called after every step with the number of steps done and of all.
    """

    def __init__(
        self, batch_size: int, enough: float | None, most_s: float | None, advance: Callable[[int, int], None]
    ) -> None:
        self.course: list[Point] = []
        self._batch_size, self._enough, self._most_s, self._advance = batch_size, enough, most_s, advance
        self._last: Progress | None = None

    def follow(self, progress: Progress) -> None:
        """After a step; the first one of an epoch tells how good the one before was."""
        if progress.stage != "training":
            return
        if self._last is not None and progress.validation is not None and progress.epoch > self._last.epoch:
            self.evaluated(progress.validation.sample_recall)
        self._last = progress
        self._advance(progress.done, progress.total or progress.done)

    def evaluated(self, recall: float) -> None:
        """After an epoch: note where the training stands, and end it where that is enough."""
        if self._last is None:
            return
        seconds = self._last.seconds
        self.course.append(Point(self._last.done * self._batch_size, seconds, recall))
        enough = self._enough is not None and recall >= self._enough
        if enough or (self._most_s is not None and seconds > self._most_s):
            raise EnoughError


def summary(courses: dict[str, list[Point]]) -> dict[str, Any]:
    """Images and seconds of both until they are as good as the default schedule's best epoch.

    Keys: `recall`, that epoch's; by schedule `images`, `seconds` and `recall` of the first epoch that is as good, or of
    the last one, and whether it is `reached`; `times_images` and `times_seconds`, the paper's over the default's, at
    least that where it is not reached.
    """
    recall = max(point.recall for point in courses[DEFAULT])
    result: dict[str, Any] = {"recall": recall}
    for schedule, course in courses.items():
        reached = next((point for point in course if point.recall >= recall), None)
        result[schedule] = asdict(reached or course[-1]) | {"reached": reached is not None}
    for what in ("images", "seconds"):
        result[f"times_{what}"] = result[PAPER][what] / result[DEFAULT][what]
    return result
