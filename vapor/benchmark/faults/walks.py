"""Walks that faults are put into: segments of synthetic sequences, and recordings."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import astuple, dataclass, replace
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Any

from filtering.errors import VaporTrackError
from sequences.datasets import listing
from sequences.options import SequenceOptions
from sequences.reader import SequenceReader
from sequences.synthesize import camera_of
from vapor.benchmark.faults.table import Film
from vapor.benchmark.recordings.record import make_recording, record_file
from vapor.benchmark.recordings.storage import FileSettings, RecordingSettings, load_recording
from vapor.benchmark.trials.choose import Trial
from vapor.benchmark.trials.replay import Replay, follow_replay, follow_trial, load_replay, trial_settings
from vapor.benchmark.trials.setup import Setup, setup_settings
from vapor.storage import fetched
from vapor.tracking.loop import Belief

NOISE_IMAGES = 50
"""How many images of noise differ; then they repeat."""

_MORE_IMAGES = 3  # for every one


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
        """The input of the methods without a fault."""
        return load_replay(self.trial, self.setup, directory.parent)

    def beliefs(self, replay: Replay) -> Mapping[str, Belief]:
        """The beliefs of the methods after each image of a replay."""
        return follow_trial(self.trial, self.setup, replay).beliefs

    def films(self) -> Mapping[Film, RecordingSettings | FileSettings]:
        """The walk upside down and with more images, rendered again; black, noise and another scene are shared."""
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


RECORDED = "recorded"
"""What recordings are reported under, where synthetic walks are by their scene."""

_OTHER_IMAGES = 300  # of another scene


@dataclass(frozen=True)
class RecordedWalk:
    """A recording with odometry and true poses.

    Attributes:
        name: Distinguishes it from the others.
        file: MCAP file or rosbag2 folder.
        setup: With which model and filter.
        reading: What to read of it.
        seed: Of all random draws.
    """

    name: str
    file: Path
    setup: Setup
    reading: SequenceOptions
    seed: int

    @property
    def group(self) -> str:
        """Recordings are reported together."""
        return RECORDED

    @cached_property
    def own(self) -> FileSettings:
        """The recording of its own images.

        Raises:
            VaporTrackError: it cannot be read.
        """
        asked = replace(self.reading, poses=None).stated | {"package": version("vapor-track")}
        made = hashlib.sha256(json.dumps(asked).encode())
        for path in (*listing.files_read(self.file), *self.reading.files_read):
            for part in sorted(path.rglob("*")) if path.is_dir() else [path]:
                if part.is_file():
                    made.update(_digest(part))
        return FileSettings(
            self.name,
            made.hexdigest()[:16],
            self.setup.network_sha256,
            self.seed,
            self.setup.num_samples,
            precision=self.setup.network.precision,
        )

    def settings(self) -> dict[str, Any]:
        """Everything that the run without a fault depends on, as JSON."""
        return json.loads(json.dumps(setup_settings(self.setup) | {"recordings": [self.own.name]}))

    def replay(self, directory: Path) -> Replay:
        """The input of the methods without a fault."""
        recording = load_recording(self.own, directory)
        odometry = tuple(map(recording.motion, range(len(recording.times_ns))))
        truth, posterior_poses = recording.path.world_from_camera, recording.posterior_poses
        return Replay(recording.times_ns, odometry, truth, posterior_poses, recording.ood_score, 0)

    def beliefs(self, replay: Replay) -> Mapping[str, Belief]:
        """The beliefs of the methods after each image of a replay."""
        return follow_replay(replay, self.setup, seed=(self.seed,)).beliefs

    def count(self) -> int:
        """Number of images that the file states."""
        return SequenceReader(self.file, self.reading).num_images

    def films(self) -> Mapping[Film, RecordingSettings | FileSettings]:
        """Its images upside down, black and noise of their size, and the corridor; none with more images."""
        setup, camera = self.setup, SequenceReader(self.file, self.reading).camera
        elsewhere = RecordingSettings(
            "corridor",  # no model of it ships
            self.seed,
            "early",
            _OTHER_IMAGES,
            setup.width,
            setup.height,
            setup.network_sha256,
            setup.num_samples,
            precision=setup.network.precision,
            camera=None if camera is None else astuple(camera),
        )
        return {
            "upside-down": replace(self.own, change="upside down"),
            "black": replace(self.own, images=1, change="black"),
            "noise": replace(self.own, images=NOISE_IMAGES, change="uniform noise"),
            "elsewhere": elsewhere,
        }

    def record(self, film: RecordingSettings | FileSettings, directory: Path) -> None:
        """Read or render a film, and show it to the network."""
        checkpoint, engine = self.setup.checkpoint(), self.setup.network.engine
        if isinstance(film, FileSettings):
            record_file(film, fetched(self.file), checkpoint, directory, self.reading, engine)
        else:
            make_recording(film, checkpoint, directory, engine)


FaultWalk = SyntheticWalk | RecordedWalk
"""A walk that faults are put into."""


def _digest(file: Path) -> bytes:
    try:
        with file.open("rb") as content:
            return hashlib.file_digest(content, "sha256").digest()
    except OSError as error:
        raise VaporTrackError(f"{file}: cannot be read ({error.strerror or error}), expected a recording") from error
