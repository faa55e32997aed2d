"""One run of a benchmark: every method over the same recorded posteriors, and what they were worth."""

from __future__ import annotations

import hashlib
import importlib.metadata
import inspect
import json
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import cache, reduce
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64

import filtering
from filtering.estimate import Mode, posterior_modes
from filtering.kalman import KalmanConfig, KalmanLocalizer
from filtering.localizer import LocalizerConfig
from filtering.motion import Odometry
from filtering.posterior import PosePosterior
from filtering.rivals import GaussianSumLocalizer
from filtering.se3 import Poses
from filtering.smoothing import SMOOTHED_MODES, SmoothingConfig, smooth
from sequences.atomic import atomic_output
from sequences.frame import Trajectory
from vapor import checkpoint, evaluate, recordings, variants, verdicts
from vapor.checkpoint import Checkpoint, load_checkpoint
from vapor.evaluate import FILES, TRACKING, dead_reckoning, evaluate_trajectory
from vapor.recordings import Recording, RecordingSettings, digest, load_recording
from vapor.threads import limited_threads
from vapor.variants import VARIANTS
from vapor.verdicts import Belief, judge_belief, mode_status, truth_among_modes
from vapor.windows import CUES, FASTEST_HZ, STAND_AFTER, STAND_S, STRIDES, Kind, Trial, recording_frames

_STREAMS = {"cue": 0, "no-cue": 1, "kidnap": 2, "standing": 3, "rate-3": 4, "rate-10": 4, "rate-30": 4}


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
        errors: What replaces numbers of the model's own error model, by name.
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
    errors: Mapping[str, Any]
    variant: str = "full"

    def recording(self, scene: str, kind: Kind, seed: int) -> RecordingSettings:
        """The recording with a seed that trials of a kind are cut from."""
        return RecordingSettings(
            scene,
            seed,
            CUES[kind],
            recording_frames(kind, self.frames),
            self.width,
            self.height,
            self.network_sha256,
            self.num_samples,
            rate_hz=FASTEST_HZ if kind in STRIDES else 10.0,
            stand=(STAND_AFTER, STAND_S) if kind == "standing" else None,
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
        posterior_poses: Posterior samples of an image, by its number.
        unfamiliarity: Of each image, (n,).
        cue_images: Number of images that show something unique.
    """

    times_ns: Int64[np.ndarray, " n"]
    odometry: tuple[Odometry, ...]
    truth: Poses
    posterior_poses: Callable[[int], Poses]
    unfamiliarity: Float64[np.ndarray, " n"]
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
    calibration = setup.checkpoint().calibration
    variant = VARIANTS[setup.variant]
    errors, config = variant.errors(calibration.errors), variant.localizer(setup.localizer)
    fit = calibration.odometry
    if fit is not None:
        config = replace(config, slow_errors=fit.slow_errors)
    rng = np.random.default_rng([trial.pieces[0].seed, trial.pieces[0].start, _STREAMS[trial.kind]])
    localizer = variant.kind(None, config, rng=rng)
    following = KalmanConfig(slow_errors=config.slow_errors, gap=config.gap)
    kalman, bank = KalmanLocalizer(following), GaussianSumLocalizer(None, config, rng=rng)
    modes: dict[str, list[tuple[Mode, ...]]] = {"kalman": [], "gaussian_sum": []}
    image_modes, told_modes, estimates, step_ms = [], [], [], []
    for i, motion in enumerate(replay.odometry):
        samples = replay.posterior_poses(i)
        odometry = motion if fit is None else fit.restated(motion)
        told = variant.told_of_kidnap and i == trial.seam
        begin = time.perf_counter()
        posterior = PosePosterior.from_samples(samples, errors, unfamiliarity=float(replay.unfamiliarity[i]))
        if told:
            localizer = variant.kind(None, config, rng=rng)
        estimates.append(localizer.update(posterior, None if told else odometry))
        step_ms.append(1e3 * (time.perf_counter() - begin))
        image_modes.append(posterior_modes(posterior))
        told_modes.append(() if posterior.says_nothing else image_modes[-1][:SMOOTHED_MODES])
        modes["kalman"].append((kalman.update(posterior, odometry),))
        modes["gaussian_sum"].append(bank.update(posterior, odometry).modes)
    widest = config.widest_std_m(errors)
    beliefs = {
        name: Belief(found, [mode_status(each[0], widest, config.converged_weight) for each in found])
        for name, found in modes.items()
    }
    beliefs["filter"] = Belief([each.modes for each in estimates], [each.status for each in estimates])
    sure = np.array([status == "converged" for status in beliefs["filter"].status])
    poses = {
        "single_image": Poses.stack([found[0].world_from_camera for found in image_modes]),
        "dead_reckoning": dead_reckoning(replay.truth[0], replay.odometry),
        **{name: belief.best for name, belief in beliefs.items()},
        "smoothed": smooth(
            told_modes,
            replay.odometry,
            np.array([each.way for each in estimates]),
            beliefs["filter"].best,
            sure,
            errors,
            SmoothingConfig(slow_errors=config.slow_errors),
        ),
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
        "particles": int(np.median([len(each.particles) for each in estimates])),
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
