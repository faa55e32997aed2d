"""One run of a benchmark: every method over the same recorded posteriors, and what they were worth."""

from __future__ import annotations

import importlib.metadata
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache, reduce
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64

from filtering.localizer import LocalizerConfig
from filtering.motion import Odometry
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from vapor.benchmark.recordings import Recording, RecordingSettings, load_recording
from vapor.benchmark.windows import KINDS, STAND_S, Kind, Piece, Trial, recorded_images, walk_frames
from vapor.cache import cached, code_digest
from vapor.checkpoints.checkpoint import Checkpoint
from vapor.checkpoints.file_format import load_checkpoint
from vapor.evaluation.floors import FLOOR_HEIGHT_M
from vapor.evaluation.lengths import scaled_calibration, scaled_localizer, scaled_odometry, scaled_poses
from vapor.tracking.ablations import VARIANTS
from vapor.tracking.methods import Followed, Passage, follow, posterior_of

_CODE = (
    "sequences.odometry_fit",
    "vapor.benchmark.recordings",
    "vapor.benchmark.trials",
    "vapor.checkpoints",
    "vapor.evaluation",
    "vapor.tracking",
)


@dataclass(frozen=True)
class Setup:
    """What trials depend on, beside which they are.

    Attributes:
        model: Model file.
        model_sha256: Of its content.
        network_sha256: Of what it says of an image: samples, and how unlike the training images it is.
        frames: Images of a trial.
        width, height: Image size in pixels.
        num_samples: Posterior samples per image.
        localizer: Settings of the filter.
        errors: What replaces numbers of the model's own error model, by name.
        variant: Which of `VARIANTS` of the filter.
        odometry_scale: Error of the odometry's distances, as a share of them; None for a random one.
    """

    model: Path
    model_sha256: str
    network_sha256: str
    frames: int
    width: int
    height: int
    num_samples: int
    localizer: LocalizerConfig
    errors: Mapping[str, Any]
    variant: str = "full"
    odometry_scale: float | None = None

    def walk(self, scene: str, kind: Kind, seed: int) -> RecordingSettings:
        """The walk with a seed that trials of a kind are cut from, ten images a second."""
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
        )

    def recording(self, scene: str, kind: Kind, piece: Piece) -> RecordingSettings:
        """The recording of that walk that a piece of a trial is a stretch of."""
        walk = self.walk(scene, kind, piece.seed)
        return replace(
            walk,
            frames=recorded_images(kind, walk.frames),
            rate_hz=KINDS[kind].recorded_hz,
            stand=None if piece.stop is None else (piece.stop, STAND_S),
        )

    def checkpoint(self) -> Checkpoint:
        """The model with the error model asked for."""
        loaded = _load(self.model, self.model_sha256)
        errors = replace(loaded.calibration.errors, **self.errors)
        return replace(loaded, calibration=replace(loaded.calibration, errors=errors))


@dataclass(frozen=True)
class Replay:
    """What the methods of a trial are given, n images.

    Attributes:
        times_ns: Stamps (n,), without a break.
        odometry: Camera motion since the image before, (n,).
        truth: True poses, batch (n,).
        posterior_poses: Posterior samples of an image, by its number; none of one that says nothing.
        unfamiliarity: Of each image, (n,).
        cue_images: Number of images that show something unique.
    """

    times_ns: Int64[np.ndarray, " n"]
    odometry: tuple[Odometry, ...]
    truth: Poses
    posterior_poses: Callable[[int], Poses]
    unfamiliarity: Float64[np.ndarray, " n"]
    cue_images: int

    def scaled(self, factor: float) -> Replay:
        """The same where all lengths are multiplied by a factor."""
        return replace(
            self,
            odometry=tuple(scaled_odometry(motion, factor) for motion in self.odometry),
            truth=scaled_poses(self.truth, factor),
            posterior_poses=lambda image: scaled_poses(self.posterior_poses(image), factor),
        )


def assemble(trial: Trial, recording: Callable[[Piece], Recording]) -> Replay:
    """Cut a trial from its recordings, by piece.

    Where the camera is carried off, stamps and odometry go on as if it had not been.
    """
    sources = [(recording(piece), piece) for piece in trial.pieces]
    first, begin = sources[0][0], trial.pieces[0].start
    images = [(source, piece.start + i, i) for source, piece in sources for i in range(piece.length)]
    odometry = []
    for position, (source, image, since_start) in enumerate(images):
        carried = position > 0 and since_start == 0
        odometry.append(first.motion(begin + position) if carried else source.motion(image))
    step_ns = int(first.times_ns[1] - first.times_ns[0]) if len(first.times_ns) > 1 else 0
    seen = range(0, len(images), trial.stride)
    parts = [[odometry[k] for k in range(max(position - trial.stride, 0) + 1, position + 1)] for position in seen]
    parts[0] = [odometry[0]]
    truth = Poses.concatenate([s.path.world_from_camera[p.start : p.start + p.length] for s, p in sources])
    unfamiliarity = np.concatenate([s.unfamiliarity[p.start : p.start + p.length] for s, p in sources])
    sees_cue = np.concatenate([s.path.sees_cue[p.start : p.start + p.length] for s, p in sources])
    return Replay(
        first.times_ns[begin] + step_ns * np.array(seen, dtype=np.int64),
        tuple(reduce(Odometry.then, part) for part in parts),
        truth[np.array(seen)],
        lambda position: images[seen[position]][0].posterior_poses(images[seen[position]][1]),
        unfamiliarity[np.array(seen)],
        int(sees_cue[np.array(seen)].sum()),
    )


def run_trial(trial: Trial, setup: Setup, directory: Path) -> dict[str, Any]:
    """Run a trial, or take the result that a run with the same settings and the same code left.

    Args:
        trial: Which.
        setup: With which model and filter.
        directory: With `recordings`; results are kept in `trials`.

    Returns:
        JSON: `name`, `scene`, `kind`, `walk` (the seed of the first piece), `variant`, `cue_images`, and what
        `Comparison.figures` gives.

    Raises:
        VaporTrackError: a recording is missing or was made with other settings.
    """
    return cached(
        directory / "trials" / f"{trial.name}-{setup.variant}",
        trial_settings(trial, setup),
        lambda: _localize(trial, setup, load_replay(trial, setup, directory)),
    )


def load_replay(trial: Trial, setup: Setup, directory: Path) -> Replay:
    """A trial as its recordings in `directory / "recordings"` have it.

    Raises:
        VaporTrackError: a recording is missing or was made with other settings.
    """
    return assemble(
        trial, lambda piece: load_recording(setup.recording(trial.scene, trial.kind, piece), directory / "recordings")
    )


def follow_trial(trial: Trial, setup: Setup, replay: Replay) -> Followed:
    """Let filter and baselines follow a trial's replay, all lengths multiplied by the trial's scale."""
    piece = trial.pieces[0]
    return follow_replay(replay, setup, seed=(piece.seed, piece.start), scale=trial.scale, seam=trial.seam)


def follow_replay(
    replay: Replay, setup: Setup, *, seed: Sequence[int], scale: float = 1.0, seam: int | None = None
) -> Followed:
    """Let filter and baselines follow a replay.

    Args:
        replay: What they are given.
        setup: Model and filter.
        seed: Of the filters' draws.
        scale: All lengths are multiplied by this.
        seam: First image after the camera was carried off; None where it was not.
    """
    replay = replay.scaled(scale)
    calibration = scaled_calibration(setup.checkpoint().calibration, scale)
    variant = VARIANTS[setup.variant]
    errors, fit = variant.errors(calibration.errors), calibration.odometry
    config = scaled_localizer(variant.localizer(setup.localizer), scale)
    if fit is not None:
        config = replace(config, slow_errors=fit.slow_errors)

    def posterior(image: int) -> PosePosterior:
        return posterior_of(replay.posterior_poses(image), errors, float(replay.unfamiliarity[image]))

    passage = Passage(replay.times_ns, replay.odometry, replay.truth, posterior).restated(fit)
    return follow(passage, errors, config, rng=np.random.default_rng(seed), variant=variant, seam=seam)


def _localize(trial: Trial, setup: Setup, replay: Replay) -> dict[str, Any]:
    # Judged in the lengths of the scene: what is right is so at any scale.
    compared = follow_trial(trial, setup, replay).compared().scaled(1.0 / trial.scale)
    return {
        "name": trial.name,
        "scene": trial.scene,
        "kind": trial.kind,
        "walk": trial.pieces[0].seed,
        "variant": setup.variant,
        "cue_images": replay.cue_images,
        **compared.figures(floor_height_m=FLOOR_HEIGHT_M.get(trial.scene)),
    }


def trial_settings(trial: Trial, setup: Setup) -> dict[str, Any]:
    """Everything that a trial's result depends on, as JSON."""
    recordings = [setup.recording(trial.scene, trial.kind, piece).name for piece in trial.pieces]
    return json.loads(json.dumps(asdict(trial) | setup_settings(setup) | {"recordings": recordings}))


def setup_settings(setup: Setup) -> dict[str, Any]:
    """Everything beside the images that a result depends on."""
    calibration = asdict(setup.checkpoint().calibration)
    package = importlib.metadata.version("vapor-track")
    more = {"calibration": calibration, "code": _code(), "package": package, "model": setup.model.name}
    return asdict(setup) | more


def _code() -> str:
    """Digest of the code that a result comes from: a filter that was changed is run again."""
    return code_digest(*_CODE)


@cache
def _load(model: Path, sha256: str) -> Checkpoint:
    return load_checkpoint(model)
