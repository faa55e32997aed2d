"""One run of a benchmark: every method over the same recorded posteriors, and what they were worth."""

from __future__ import annotations

import hashlib
import importlib.metadata
import inspect
import json
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int64

import filtering
from filtering.estimate import posterior_modes
from filtering.kalman import KalmanLocalizer
from filtering.localizer import LocalizerConfig
from filtering.motion import Odometry
from filtering.posterior import LikelihoodModel
from filtering.se3 import Poses
from filtering.smoothing import SMOOTHED_MODES, smooth
from sequences.atomic import atomic_output
from sequences.frame import Trajectory
from vapor import checkpoint, evaluate, recordings, variants, verdicts
from vapor.checkpoint import Calibration, Checkpoint, load_checkpoint
from vapor.evaluate import FILES, TRACKING, dead_reckoning, evaluate_trajectory
from vapor.recordings import Recording, RecordingSettings, digest, load_recording
from vapor.threads import limited_threads
from vapor.variants import VARIANTS
from vapor.verdicts import Belief, judge_belief, mode_status, truth_among_modes
from vapor.windows import CUES, Kind, Trial, recording_frames

_STREAMS = {"cue": 0, "no-cue": 1, "kidnap": 2}


@dataclass(frozen=True)
class Setup:
    """What trials depend on, beside which they are.

    Attributes:
        model: Model file.
        model_sha256: Of its content.
        network_sha256: Of what its posterior samples depend on.
        frames: Images of a trial.
        width, height: Image size in pixels.
        num_samples: Posterior samples per image.
        localizer: Settings of the filter.
        calibration: What replaces the model's own calibration, by name.
        variant: Which of `VARIANTS` of the filter.
    """

    model: Path
    model_sha256: str
    network_sha256: str
    frames: int
    width: int
    height: int
    num_samples: int
    localizer: LocalizerConfig
    calibration: Mapping[str, float]
    variant: str = "full"

    def recording(self, scene: str, kind: Kind, seed: int) -> RecordingSettings:
        """The recording with a seed that trials of a kind are cut from."""
        frames = recording_frames(kind, self.frames)
        return RecordingSettings(
            scene, seed, CUES[kind], frames, self.width, self.height, self.network_sha256, self.num_samples
        )

    def checkpoint(self) -> Checkpoint:
        """The model with the calibration asked for."""
        loaded = _load(self.model, self.model_sha256)
        return replace(loaded, calibration=replace(loaded.calibration, **self.calibration))


@dataclass(frozen=True)
class Replay:
    """What the methods of a trial are given, n images.

    Attributes:
        times_ns: Stamps (n,), without a break.
        odometry: Camera motion since the image before, (n,).
        truth: True poses, batch (n,).
        posterior_poses: Posterior samples of an image, by its number.
        cue_images: Number of images that show something unique.
    """

    times_ns: Int64[np.ndarray, " n"]
    odometry: tuple[Odometry, ...]
    truth: Poses
    posterior_poses: Callable[[int], Poses]
    cue_images: int


def assemble(trial: Trial, recording: Callable[[int], Recording]) -> Replay:
    """Cut a trial from its recordings, by seed.

    Where the camera is carried off, stamps and odometry go on as if it had not been.
    """
    sources = [(recording(piece.seed), piece) for piece in trial.pieces]
    first, begin = sources[0][0], trial.pieces[0].start
    images = [(source, piece.start + i, i) for source, piece in sources for i in range(piece.length)]
    odometry = []
    for position, (source, image, since_start) in enumerate(images):
        carried = position > 0 and since_start == 0
        odometry.append(first.motion(begin + position) if carried else source.motion(image))
    step_ns = int(first.times_ns[1] - first.times_ns[0]) if len(first.times_ns) > 1 else 0
    return Replay(
        first.times_ns[begin] + step_ns * np.arange(len(images), dtype=np.int64),
        tuple(odometry),
        Poses.concatenate([s.path.world_from_camera[p.start : p.start + p.length] for s, p in sources]),
        lambda position: images[position][0].posterior_poses(images[position][1]),
        sum(int(s.path.sees_cue[p.start : p.start + p.length].sum()) for s, p in sources),
    )


def run_trial(trial: Trial, setup: Setup, directory: Path) -> dict[str, Any]:
    """Run a trial, or take the result that a run with the same settings and the same code left.

    Args:
        trial: Which.
        setup: With which model and filter.
        directory: With `recordings`; results are kept in `trials`.

    Returns:
        JSON: `name`, `scene`, `kind`, `variant`, `images`, `cue_images`, `methods` (see `evaluate_trajectory`),
        `belief` of Kalman filter and particle filter (see `judge_belief`), `image_truth_among_modes` (of the single
        images' posteriors), `particles` and `step_ms` (medians).

    Raises:
        VaporTrackError: a recording is missing or was made with other settings.
    """
    settings = _settings(trial, setup)
    file = directory / "trials" / f"{trial.name}-{setup.variant}-{digest(settings)}.json"
    try:
        return json.loads(file.read_text(encoding="utf-8"))["result"]
    except (OSError, ValueError, KeyError):
        pass
    replay = assemble(
        trial, lambda seed: load_recording(setup.recording(trial.scene, trial.kind, seed), directory / "recordings")
    )
    with limited_threads(1):
        result = _localize(trial, setup, replay)
    file.parent.mkdir(parents=True, exist_ok=True)
    with atomic_output(file) as partial:
        partial.write_text(json.dumps({"settings": settings, "result": result}, indent=1), encoding="utf-8")
    return result


def _localize(trial: Trial, setup: Setup, replay: Replay) -> dict[str, Any]:
    model = setup.checkpoint()
    variant = VARIANTS[setup.variant]
    likelihood = variant.likelihood(_likelihood(setup.model, setup.model_sha256, model.calibration), model.prior_poses)
    config = variant.localizer(setup.localizer)
    seed = [trial.pieces[0].seed, trial.pieces[0].start, _STREAMS[trial.kind]]
    filter_rng, mode_rng = np.random.default_rng(seed).spawn(2)
    localizer, kalman = variant.kind(None, config, rng=filter_rng), KalmanLocalizer()
    image_modes, estimates, kalman_modes, step_ms = [], [], [], []
    for i, motion in enumerate(replay.odometry):
        poses = replay.posterior_poses(i)
        begin = time.perf_counter()
        posterior = model.calibration.posterior(poses, likelihood)
        told = variant.told_of_kidnap and i == trial.seam
        estimate = localizer.update(posterior, None if told else motion)
        step_ms.append(1e3 * (time.perf_counter() - begin))
        estimates.append((estimate.modes, estimate.status, len(estimate.particles)))
        image_modes.append(posterior_modes(poses, setup.localizer.modes, rng=mode_rng))
        kalman_modes.append(kalman.update(image_modes[-1][0], motion))
    beliefs = {
        "kalman": Belief(
            [(mode,) for mode in kalman_modes],
            [mode_status(mode, setup.localizer.converged_std_m) for mode in kalman_modes],
        ),
        "filter": Belief([modes for modes, _, _ in estimates], [status for _, status, _ in estimates]),
    }
    sure = np.array([status == "converged" for status in beliefs["filter"].status])
    few_modes = [modes[:SMOOTHED_MODES] for modes in image_modes]
    poses = {
        "single_image": Poses.stack([modes[0].world_from_camera for modes in image_modes]),
        "dead_reckoning": dead_reckoning(replay.truth[0], replay.odometry),
        "kalman": beliefs["kalman"].best,
        "filter": beliefs["filter"].best,
        "smoothed": smooth(few_modes, replay.odometry, beliefs["filter"].best, sure),
    }
    truth = Trajectory(replay.times_ns, replay.truth)
    # Whoever is carried off has no one moment from which on all is right.
    tracking = TRACKING if trial.seam is None else ()
    methods = {
        name: evaluate_trajectory(Trajectory(replay.times_ns, poses[name]), truth, tracking=name in tracking)
        for name in FILES
    }
    return {
        "name": trial.name,
        "scene": trial.scene,
        "kind": trial.kind,
        "variant": setup.variant,
        "images": len(replay.times_ns),
        "cue_images": replay.cue_images,
        "methods": methods,
        "belief": {
            name: judge_belief(
                belief,
                replay.times_ns,
                replay.truth,
                converged_at_s=methods[name].get("converged_at_s"),
                seam=trial.seam,
            )
            for name, belief in beliefs.items()
        },
        "image_truth_among_modes": truth_among_modes(image_modes, replay.truth),
        "particles": int(np.median([particles for _, _, particles in estimates])),
        "step_ms": float(np.median(step_ms)),
    }


def _settings(trial: Trial, setup: Setup) -> dict[str, Any]:
    """Everything that a result depends on."""
    calibration = asdict(setup.checkpoint().calibration)
    content = asdict(trial) | asdict(setup) | {"calibration": calibration, "code": _code()}
    content["package"] = importlib.metadata.version("vapor-track")
    content["model"] = setup.model.name
    content["recordings"] = [setup.recording(trial.scene, trial.kind, piece.seed).name for piece in trial.pieces]
    return json.loads(json.dumps(content))


@cache
def _code() -> str:
    """Digest of the code that a result comes from: a filter that was changed is run again."""
    files = sorted(Path(str(filtering.__path__[0])).glob("*.py"))
    files += [Path(inspect.getfile(module)) for module in (checkpoint, evaluate, recordings, variants, verdicts)]
    files.append(Path(__file__))
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:16]


@cache
def _load(model: Path, sha256: str) -> Checkpoint:
    return load_checkpoint(model)


@cache
def _likelihood(model: Path, sha256: str, calibration: Calibration) -> LikelihoodModel:
    return calibration.likelihood(_load(model, sha256).prior_poses)
