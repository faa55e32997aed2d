"""Model, image size, filter and recordings that trials depend on."""

from __future__ import annotations

import hashlib
import importlib.metadata
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Annotated, Any

import tyro

from filtering.config import LocalizerConfig
from filtering.errors import VaporTrackError, require_within
from vapor.benchmark.recordings.record import camera_path, make_recording
from vapor.benchmark.recordings.storage import CameraPath, RecordingSettings, seen_digest
from vapor.benchmark.trials import choose
from vapor.benchmark.trials.choose import KINDS, Excerpt, Kind, recorded_images, walk_frames
from vapor.cache import code_digest
from vapor.checkpoints.checkpoint import Checkpoint
from vapor.checkpoints.file_format import find_model, load_checkpoint
from vapor.engines.engine import EngineConfig

_MAX_SEED = 2**62
_CODE = (
    "sequences.odometry_fit",
    "vapor.benchmark.evaluation",
    "vapor.benchmark.recordings",
    "vapor.benchmark.trials",
    "vapor.checkpoints",
    "vapor.evaluation",
    "vapor.tracking",
)


@dataclass(frozen=True)
class ReplayConfig(EngineConfig):
    """Settings of the replay of a recording: the images, the network, the filter."""

    frames: int = 300
    """Images of each run."""
    width: int = 240
    """Image width in pixels."""
    height: int = 180
    """Image height in pixels."""
    odometry_scale: float | None = None
    """Error of the odometry's distances, as a fraction of them, instead of a random one for each recording: at 0.02
    they are 2 % too long."""
    num_samples: int = 1000
    """Posterior samples per image."""
    localizer: LocalizerConfig = field(default_factory=LocalizerConfig)
    """The particle filter."""

    def __post_init__(self) -> None:
        sides = dict.fromkeys(("width", "height"), (8, 10**5))
        require_within(self, frames=(1, 10**6), num_samples=(1, 10**6), **sides)
        if self.odometry_scale is not None:
            require_within(self, odometry_scale=(-1.0, 10.0))
        if self.frames < 50:
            raise VaporTrackError(f"frames is {self.frames}, expected at least 50: half a second is a tenth of them")


@dataclass(frozen=True)
class TrialsConfig:
    """Settings of a benchmark that replays recordings, the same for all its scenes."""

    first_seed: int = 2000
    """Seeds of the sequences count up from here."""
    workers: int = 2
    """Processes at a time, each with one thread."""
    replay: Annotated[ReplayConfig, tyro.conf.arg(name="")] = field(default_factory=ReplayConfig)

    def __post_init__(self) -> None:
        require_within(self, workers=(1, 10**6), first_seed=(0, _MAX_SEED))


@dataclass(frozen=True)
class Setup:
    """What trials depend on besides which they are.

    Attributes:
        model_sha256: Of the content of the model file.
        network_sha256: Of all that samples and OOD score of an image depend on.
        config: Images, network and filter.
        ablation: Name of the filter's ablation.
    """

    model: Path
    model_sha256: str
    network_sha256: str
    config: ReplayConfig
    ablation: str = "full"

    @staticmethod
    def of(model: str, config: ReplayConfig) -> Setup:
        """The setup for a model, by its file or its name. Raises VaporTrackError where it cannot be used."""
        file = find_model(model)
        sha256 = hashlib.sha256(file.read_bytes()).hexdigest()
        return Setup(file, sha256, seen_digest(load_checkpoint(file)), config)

    def walk(self, scene: str, kind: Kind, seed: int) -> RecordingSettings:
        """The walk with a seed that trials of a kind are cut from, at ten images a second."""
        c = self.config
        return RecordingSettings(
            scene,
            seed,
            KINDS[kind].cues,
            walk_frames(kind, c.frames),
            c.width,
            c.height,
            self.network_sha256,
            c.num_samples,
            odometry_scale=c.odometry_scale,
            precision=c.precision,
        )

    def recording(self, scene: str, kind: Kind, segment: Excerpt) -> RecordingSettings:
        """The recording of that walk that a trial's segment is cut from."""
        walk = self.walk(scene, kind, segment.seed)
        return replace(
            walk,
            frames=recorded_images(kind, walk.frames),
            rate_hz=KINDS[kind].recorded_hz,
            stand=None if segment.stop is None else (segment.stop, choose.STAND_S),
        )

    def record(self, settings: RecordingSettings, directory: Path) -> None:
        """Make a recording unless it is there."""
        make_recording(settings, self.checkpoint(), directory, self.config.engine)

    def camera_paths(self, scene: str, kind: Kind) -> Callable[[int], CameraPath]:
        """The walks that trials of a kind are cut from, by seed; each is computed once."""
        return cache(lambda seed: camera_path(self.walk(scene, kind, seed)))

    def checkpoint(self) -> Checkpoint:
        """The model."""
        return _load(self.model, self.model_sha256)

    def settings(self) -> dict[str, Any]:
        """Everything besides the images that a result depends on."""
        config = asdict(self.config)
        del config["engine"]  # engines agree within rounding
        return asdict(self) | {
            "config": config,
            "calibration": asdict(self.checkpoint().calibration),
            "code": results_code(),
            "package": importlib.metadata.version("vapor-track"),
            "model": self.model.name,
        }


def results_code() -> str:
    """Digest of the code that a result comes from: a filter that was changed is run again."""
    return code_digest(*_CODE)


@cache
def _load(model: Path, sha256: str) -> Checkpoint:
    return load_checkpoint(model)
