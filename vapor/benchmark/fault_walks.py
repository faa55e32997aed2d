"""Walks that faults befall: stretches of synthetic sequences, and recordings."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import astuple, dataclass, replace
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Any, Protocol

from filtering.errors import VaporTrackError
from sequences.datasets import listing
from sequences.options import SequenceOptions
from sequences.reader import SequenceReader
from sequences.synthesize import camera_of
from vapor.benchmark.faults import Film
from vapor.benchmark.recordings import FileSettings, RecordingSettings, load_recording, make_recording, record_file
from vapor.benchmark.trials import (
    Replay,
    Setup,
    follow_replay,
    follow_trial,
    load_replay,
    setup_settings,
    trial_settings,
)
from vapor.benchmark.windows import Trial
from vapor.tracking.belief import Belief

RECORDED = "recorded"
"""What recordings are told as, where synthetic walks are by their scene."""

_MORE_IMAGES = 3  # for every one
_NOISE_IMAGES, _OTHER_IMAGES = 50, 300  # that differ; walks share them


class FaultWalk(Protocol):
    """A walk that faults may befall; `directory` is that of its recordings."""

    @property
    def name(self) -> str:
        """Of its own."""
        ...

    @property
    def group(self) -> str:
        """What it is told with."""
        ...

    def settings(self) -> dict[str, Any]:
        """Everything that the run without a fault depends on, as JSON."""
        ...

    def replay(self, directory: Path) -> Replay:
        """What methods are given without a fault."""
        ...

    def beliefs(self, replay: Replay) -> Mapping[str, Belief]:
        """What the methods believe after each image of a replay."""
        ...

    def films(self) -> Mapping[Film, RecordingSettings | FileSettings]:
        """The recordings of what the camera may show in place of the walk."""
        ...

    def record(self, film: RecordingSettings | FileSettings, directory: Path) -> None:
        """Show the network a film."""
        ...


@dataclass(frozen=True)
class SyntheticWalk:
    """A stretch of a synthetic sequence.

    Attributes:
        trial: Which.
        setup: With which model and filter.
        shared_seed: Of the films that all walks share.
    """

    trial: Trial
    setup: Setup
    shared_seed: int

    @property
    def name(self) -> str:
        """Of the trial."""
        return self.trial.name

    @property
    def group(self) -> str:
        """Its scene."""
        return self.trial.scene

    @property
    def seed(self) -> int:
        """Of its recording."""
        return self.trial.pieces[0].seed

    def settings(self) -> dict[str, Any]:
        """Everything that the run without a fault depends on, as JSON."""
        return trial_settings(self.trial, self.setup)

    def replay(self, directory: Path) -> Replay:
        """What methods are given without a fault."""
        return load_replay(self.trial, self.setup, directory.parent)

    def beliefs(self, replay: Replay) -> Mapping[str, Belief]:
        """What the methods believe after each image of a replay."""
        return follow_trial(self.trial, self.setup, replay).beliefs

    def films(self) -> Mapping[Film, RecordingSettings | FileSettings]:
        """The walk turned over and with more images, rendered anew; black, noise and another scene are shared."""
        (piece,), scene = self.trial.pieces, self.trial.scene
        own = self.setup.recording(scene, "cue", piece)
        shared = replace(own, seed=self.shared_seed)
        more = (_MORE_IMAGES * piece.start, _MORE_IMAGES * (piece.length - 1) + 1)
        return {
            "upside-down": replace(own, part=(piece.start, piece.length), change="upside down"),
            "three-times": replace(
                own, frames=_MORE_IMAGES * own.frames, rate_hz=_MORE_IMAGES * own.rate_hz, part=more
            ),
            "black": replace(shared, frames=1, change="black"),
            "noise": replace(shared, frames=_NOISE_IMAGES, change="uniform noise"),
            "elsewhere": replace(
                shared,
                scene="ceiling" if scene != "ceiling" else "staircase",
                frames=piece.length,
                camera=astuple(camera_of(scene, own.width, own.height)),
            ),
        }

    def record(self, film: RecordingSettings | FileSettings, directory: Path) -> None:
        """Render a film, and show it to the network."""
        assert isinstance(film, RecordingSettings)
        make_recording(film, self.setup.checkpoint(), directory)


@dataclass(frozen=True)
class RecordedWalk:
    """A recording with odometry and true poses.

    Attributes:
        name: That tells it from the others.
        file: MCAP file or rosbag2 folder.
        setup: With which model and filter.
        reading: What to read of it.
        seed: Of draws.
    """

    name: str
    file: Path
    setup: Setup
    reading: SequenceOptions
    seed: int

    @property
    def group(self) -> str:
        """Recordings are told together."""
        return RECORDED

    @cached_property
    def own(self) -> FileSettings:
        """Of its own images.

        Raises:
            VaporTrackError: it cannot be read.
        """
        asked = replace(self.reading, poses=None, poses_times=None).told | {"package": version("vapor-track")}
        made = hashlib.sha256(json.dumps(asked).encode())
        for path in (*listing.files_read(self.file), *self.reading.files_read):
            for part in sorted(path.rglob("*")) if path.is_dir() else [path]:
                if part.is_file():
                    made.update(_digest(part))
        return FileSettings(
            self.name, made.hexdigest()[:16], self.setup.network_sha256, self.seed, self.setup.num_samples
        )

    def settings(self) -> dict[str, Any]:
        """Everything that the run without a fault depends on, as JSON."""
        return json.loads(json.dumps(setup_settings(self.setup) | {"recordings": [self.own.name]}))

    def replay(self, directory: Path) -> Replay:
        """What methods are given without a fault."""
        recording = load_recording(self.own, directory)
        odometry = tuple(map(recording.motion, range(len(recording.times_ns))))
        truth, posterior_poses = recording.path.world_from_camera, recording.posterior_poses
        return Replay(recording.times_ns, odometry, truth, posterior_poses, recording.unfamiliarity, 0)

    def beliefs(self, replay: Replay) -> Mapping[str, Belief]:
        """What the methods believe after each image of a replay."""
        return follow_replay(replay, self.setup, seed=(self.seed,)).beliefs

    def count(self) -> int:
        """How many images the file states."""
        return SequenceReader(self.file, self.reading).num_images

    def films(self) -> Mapping[Film, RecordingSettings | FileSettings]:
        """Its images turned over, black and noise of their size, and the corridor; nothing has more images."""
        setup, camera = self.setup, SequenceReader(self.file, self.reading).camera
        elsewhere = RecordingSettings(
            "corridor",  # of which no model ships
            self.seed,
            "early",
            _OTHER_IMAGES,
            setup.width,
            setup.height,
            setup.network_sha256,
            setup.num_samples,
            camera=None if camera is None else astuple(camera),
        )
        return {
            "upside-down": replace(self.own, change="upside down"),
            "black": replace(self.own, images=1, change="black"),
            "noise": replace(self.own, images=_NOISE_IMAGES, change="uniform noise"),
            "elsewhere": elsewhere,
        }

    def record(self, film: RecordingSettings | FileSettings, directory: Path) -> None:
        """Read or render a film, and show it to the network."""
        checkpoint = self.setup.checkpoint()
        if isinstance(film, FileSettings):
            record_file(film, self.file, checkpoint, directory, self.reading)
        else:
            make_recording(film, checkpoint, directory)


def _digest(file: Path) -> bytes:
    try:
        with file.open("rb") as content:
            return hashlib.file_digest(content, "sha256").digest()
    except OSError as error:
        raise VaporTrackError(f"{file}: cannot be read ({error.strerror or error}), expected a recording") from error
