"""Walks that faults are put into: what every kind of walk must offer, and segments of synthetic sequences."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import astuple, dataclass, replace
from pathlib import Path
from typing import Any, Protocol

from sequences.synthesize import camera_of
from vapor.benchmark.faults.table import Film
from vapor.benchmark.recordings.record import make_recording
from vapor.benchmark.recordings.settings import FileSettings, RecordingSettings
from vapor.benchmark.trials.replay import Replay, follow_trial, load_replay, trial_settings
from vapor.benchmark.trials.setup import Setup
from vapor.benchmark.trials.trial import Trial
from vapor.tracking.loop import Belief

NOISE_IMAGES = 50
"""How many images of noise differ; then they repeat."""

_MORE_IMAGES = 3  # for every one


class FaultWalk(Protocol):
    """A walk that faults are put into; `directory` is that of its recordings."""

    @property
    def name(self) -> str:
        """Its own name."""
        ...

    @property
    def group(self) -> str:
        """Name of the walks that it is reported with."""
        ...

    def settings(self) -> dict[str, Any]:
        """Everything that the run without a fault depends on, as JSON."""
        ...

    def replay(self, directory: Path) -> Replay:
        """What the methods are given without a fault."""
        ...

    def beliefs(self, replay: Replay) -> Mapping[str, Belief]:
        """What the methods believe after each image of a replay."""
        ...

    def films(self) -> Mapping[Film, RecordingSettings | FileSettings]:
        """The recordings of what the camera may show instead of the walk."""
        ...

    def record(self, film: RecordingSettings | FileSettings, directory: Path) -> None:
        """Show the network a film."""
        ...


@dataclass(frozen=True)
class SyntheticWalk:
    """A segment of a synthetic sequence.

    Attributes:
        trial: Which.
        setup: With which model and filter.
        shared_seed: Seed of the films that all walks share.
    """

    trial: Trial
    setup: Setup
    shared_seed: int

    @property
    def name(self) -> str:
        """The trial's name."""
        return self.trial.name

    @property
    def group(self) -> str:
        """Its scene."""
        return self.trial.scene

    @property
    def seed(self) -> int:
        """Seed of its recording."""
        return self.trial.segments[0].seed

    def settings(self) -> dict[str, Any]:
        """Everything that the run without a fault depends on, as JSON."""
        return trial_settings(self.trial, self.setup)

    def replay(self, directory: Path) -> Replay:
        """What the methods are given without a fault."""
        return load_replay(self.trial, self.setup, directory.parent)

    def beliefs(self, replay: Replay) -> Mapping[str, Belief]:
        """What the methods believe after each image of a replay."""
        return follow_trial(self.trial, self.setup, replay).beliefs

    def films(self) -> Mapping[Film, RecordingSettings | FileSettings]:
        """The walk upside down and with more images, rendered anew; black, noise and another scene are shared."""
        (segment,), scene = self.trial.segments, self.trial.scene
        own = self.setup.recording(scene, "cue", segment)
        shared = replace(own, seed=self.shared_seed)
        more = (_MORE_IMAGES * segment.start, _MORE_IMAGES * (segment.length - 1) + 1)
        return {
            "upside-down": replace(own, part=(segment.start, segment.length), change="upside down"),
            "three-times": replace(
                own, frames=_MORE_IMAGES * own.frames, rate_hz=_MORE_IMAGES * own.rate_hz, part=more
            ),
            "black": replace(shared, frames=1, change="black"),
            "noise": replace(shared, frames=NOISE_IMAGES, change="uniform noise"),
            "elsewhere": replace(
                shared,
                scene="ceiling" if scene != "ceiling" else "staircase",
                frames=segment.length,
                camera=astuple(camera_of(scene, own.width, own.height)),
            ),
        }

    def record(self, film: RecordingSettings | FileSettings, directory: Path) -> None:
        """Render a film, and show it to the network."""
        assert isinstance(film, RecordingSettings)
        make_recording(film, self.setup.checkpoint(), directory, self.setup.network.engine)
