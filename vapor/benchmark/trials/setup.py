"""Model, image size, filter and recordings that trials depend on."""

from __future__ import annotations

import hashlib
import importlib.metadata
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

from filtering.config import LocalizerConfig
from filtering.errors import VaporTrackError, require_within
from vapor.benchmark.recordings.record import camera_path, make_recording
from vapor.benchmark.recordings.storage import CameraPath, RecordingSettings, not_recorded, seen_digest
from vapor.benchmark.trials import choose
from vapor.benchmark.trials.choose import KINDS, Excerpt, Kind, recorded_images, walk_frames
from vapor.cache import code_digest
from vapor.checkpoints.checkpoint import Checkpoint
from vapor.checkpoints.file_format import find_model, load_checkpoint
from vapor.engines.engine import EngineConfig
from vapor.parallel.jobs import Workers, in_parallel
from vapor.storage import fetched

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
class TrialsConfig(EngineConfig):
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
    """Error of the odometry's distances, as a fraction of them, instead of a random one for each recording: at 0.02
    they are 2 % too long."""
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
class Setup:
    """What trials depend on besides which they are.

    Attributes:
        model_sha256: Of the content of the model file.
        network_sha256: Of all that samples and OOD score of an image depend on.
        frames: Images of a trial.
        ablation: Name of the filter's ablation.
        odometry_scale: Error of the odometry's distances, as a fraction of them; None for a random one.
    """

    model: Path
    model_sha256: str
    network_sha256: str
    frames: int
    width: int
    height: int
    num_samples: int
    localizer: LocalizerConfig
    ablation: str = "full"
    odometry_scale: float | None = None
    network: EngineConfig = field(default_factory=EngineConfig)

    def walk(self, scene: str, kind: Kind, seed: int) -> RecordingSettings:
        """The walk with a seed that trials of a kind are cut from, at ten images a second."""
        return RecordingSettings(
            scene,
            seed,
            KINDS[kind].cues,
            walk_frames(kind, self.frames),
            self.width,
            self.height,
            self.network_sha256,
            self.num_samples,
            odometry_scale=self.odometry_scale,
            precision=self.network.precision,
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

    def checkpoint(self) -> Checkpoint:
        """The model."""
        return _load(self.model, self.model_sha256)


def make_setups(scenes: Mapping[str, str], config: TrialsConfig) -> dict[str, Setup]:
    """Settings of the runs of each scene.

    Args:
        scenes: Names of scenes, each with the model to localize by: a file, or the name of one that ships.
        config: Settings.

    Raises:
        VaporTrackError: a model that cannot be used.
    """
    images = config.frames, config.width, config.height
    setups = {}
    for scene, name in scenes.items():
        model = find_model(name)
        sha256 = hashlib.sha256(model.read_bytes()).hexdigest()
        network_sha256 = seen_digest(load_checkpoint(model))
        setups[scene] = Setup(
            model,
            sha256,
            network_sha256,
            *images,
            config.num_samples,
            config.localizer,
            odometry_scale=config.odometry_scale,
            network=config.network,
        )
    return setups


def setup_settings(setup: Setup) -> dict[str, Any]:
    """Everything besides the images that a result depends on."""
    calibration = asdict(setup.checkpoint().calibration)
    package = importlib.metadata.version("vapor-track")
    more = {"calibration": calibration, "code": results_code(), "package": package, "model": setup.model.name}
    # Engines agree within rounding: which one it was does not matter.
    return asdict(setup) | {"network": {"precision": setup.network.precision}} | more


def results_code() -> str:
    """Digest of the code that a result comes from: a filter that was changed is run again."""
    return code_digest(*_CODE)


@cache
def _load(model: Path, sha256: str) -> Checkpoint:
    return load_checkpoint(fetched(model))


def make_recordings(
    wanted: Mapping[RecordingSettings, Setup], directory: Path, workers: Workers
) -> Iterator[tuple[int, int]]:
    """Make the recordings that are missing; yields the number done and the number of all after each."""
    jobs = [(settings, wanted[settings], directory) for settings in not_recorded(wanted, directory)]
    for done, _ in enumerate(in_parallel(_make, jobs, workers), len(wanted) - len(jobs) + 1):
        yield done, len(wanted)


def camera_paths(setup: Setup, scene: str, kind: Kind, directory: Path) -> Callable[[int], CameraPath]:
    """The walks that trials of a kind are cut from, by seed; each is computed once."""
    return cache(lambda seed: camera_path(setup.walk(scene, kind, seed), directory))


def _make(settings: RecordingSettings, setup: Setup, directory: Path) -> None:
    make_recording(settings, setup.checkpoint(), directory, setup.network.engine)
