"""Calibration of a trained network on held-out images and stretches of trajectory, by likelihood and coverage."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from filtering.errors import VaporTrackError
from filtering.localizer import LocalizerConfig
from filtering.se3 import Poses
from vapor.checkpoint import Calibration, find_model, load_checkpoint, read_safetensors, save_checkpoint, spaced
from vapor.image_fit import Change, fit_images
from vapor.network import PoseRegressor
from vapor.observation import Device, resolve_device
from vapor.stretches import (
    GRIDS,
    LEAST_STRETCHES,
    Choice,
    Scores,
    Stretch,
    belief_scores,
    choose,
    choose_detail,
    find_stretches,
    simulated_odometry,
)
from vapor.threads import limited_threads
from vapor.training_set import TrainingSet, load_training_set, open_sequences
from vapor.validation import predict

NUM_SAMPLES = 1000  # an image, as in use: fewer want wider kernels
LEAST_IMAGES = 50

Advance = Callable[[int, int], None]


@dataclass(frozen=True)
class CalibrationResult:
    """A calibration and where it comes from.

    Attributes:
        calibration: The values.
        changes: One for each fit.
        images: Held-out images of the fits image by image; 0 where there were too few.
        stretches: Held-out stretches with odometry; 0 where there were too few.
        odometry: Where that came from.
        notes: What was kept, and why.
        skipped: Images and poses of the data that were left out in reading, by reason.
    """

    calibration: Calibration
    changes: tuple[Change, ...] = ()
    images: int = 0
    stretches: int = 0
    odometry: str = "none"
    notes: tuple[str, ...] = ()
    skipped: Mapping[str, int] = field(default_factory=dict)

    @property
    def provenance(self) -> dict[str, Any]:
        """JSON for the model file: all but the values themselves and what was left out."""
        return {key: value for key, value in asdict(self).items() if key not in ("calibration", "skipped")}


def calibrate_model(
    model: str,
    data: Sequence[Path | str],
    output: Path,
    *,
    max_images: int = 500,
    seed: int = 0,
    device: Device = "auto",
    advance: Advance = lambda done, total: None,
) -> CalibrationResult:
    """Calibrate a model that was trained before, and write it with its weights untouched.

    Args:
        model: Model file, or name of a model that ships.
        data: Held-out files and folders with true poses, as for `train`.
        output: The model file to write.
        max_images: Held-out images of each kind of fit, at most.
        seed: Of latent noise and filter.
        device: Where the network runs.
        advance: Called with the number of filter runs done and of all.

    Raises:
        VaporTrackError: unusable model or data, or too little of it to calibrate anything.
    """
    file, output = find_model(model), Path(output)
    if output.is_dir() or not output.parent.is_dir():
        raise VaporTrackError(f"{output}: cannot be written, expected the name of a model file in an existing folder")
    checkpoint = load_checkpoint(file)
    config = checkpoint.network
    held_out = load_training_set(open_sequences(data), config.frame_size)
    if len(held_out) < LEAST_IMAGES:
        names = ", ".join(Path(str(entry)).name for entry in data)
        raise VaporTrackError(f"{names}: {len(held_out)} images with true poses, expected at least {LEAST_IMAGES}")
    result = calibrate(
        checkpoint.build_network().to(resolve_device(device)),
        held_out,
        checkpoint.prior_poses,
        checkpoint.calibration,
        max_images=max_images,
        seed=seed,
        advance=advance,
    )
    half = any(tensor.dtype == torch.float16 for tensor in read_safetensors(file)[1].values())
    names = {"data": [Path(str(entry)).name for entry in data]}
    training = {**checkpoint.training, "calibration": names | result.provenance}
    save_checkpoint(output, replace(checkpoint, calibration=result.calibration, training=training), half=half)
    return replace(result, skipped=held_out.skipped)


def calibrate(
    network: PoseRegressor,
    held_out: TrainingSet,
    prior_poses: Poses,
    calibration: Calibration,
    *,
    max_images: int,
    seed: int,
    advance: Advance = lambda done, total: None,
) -> CalibrationResult:
    """Fit kernel widths, prior and outlier floor image by image, and β, γ and β_d with the filter on stretches.

    Args:
        network: With its final weights.
        held_out: Images that it was not trained on, in order of time.
        prior_poses: Of the model, (n,).
        calibration: Values to start from, and to keep where there is too little data.
        max_images: Of each of the two kinds of fit, at most.
        seed: Of latent noise and filter.
        advance: Called with the number of filter runs done and of all.
    """
    if len(held_out) < LEAST_IMAGES:
        note = f"{len(held_out)} held-out images, at least {LEAST_IMAGES} are needed: calibration kept as it was"
        return CalibrationResult(calibration, notes=(note,))
    single = spaced(len(held_out), max_images)
    pieces = find_stretches(held_out, max_images)
    needed = np.unique(np.concatenate([single, *pieces]))
    samples = dict(zip(needed.tolist(), predict(network, held_out.select(needed), NUM_SAMPLES, seed), strict=True))
    calibration, changes = fit_images(
        [samples[i] for i in single.tolist()], held_out.poses[single], prior_poses, calibration
    )
    if len(pieces) < LEAST_STRETCHES:
        note = f"{len(pieces)} held-out stretches, at least {LEAST_STRETCHES} are needed: β, γ and β_d kept"
        return CalibrationResult(calibration, changes, len(single), notes=(note,))
    rng = np.random.default_rng(seed)
    stretches, simulated = [], 0
    for piece in pieces:
        odometry = [held_out.odometry[i] for i in piece]
        if any(increment is None for increment in odometry[1:]):
            odometry, simulated = simulated_odometry(held_out, piece, rng=rng), simulated + 1
        stretches.append(Stretch([samples[i] for i in piece.tolist()], odometry, held_out.poses[piece]))
    calibration, more = fit_stretches(stretches, prior_poses, calibration, seed=seed, advance=advance)
    source = "recorded" if not simulated else f"simulated from true poses on {simulated} of {len(pieces)} stretches"
    return CalibrationResult(calibration, changes + more, len(single), len(pieces), source)


def fit_stretches(
    stretches: Sequence[Stretch],
    prior_poses: Poses,
    calibration: Calibration,
    *,
    config: LocalizerConfig | None = None,
    seed: int = 0,
    advance: Advance = lambda done, total: None,
) -> tuple[Calibration, tuple[Change, ...]]:
    """β and γ by the log density of the filter's belief at the true poses, then β_d, if its regions hold enough."""
    likelihoods = calibration.likelihood(prior_poses)
    known: dict[Calibration, Scores] = {}
    total = sum(len(grid) for grid in GRIDS.values()) - len(GRIDS) + 1

    def score(candidate: Calibration) -> Scores:
        if candidate not in known:
            likelihood = replace(
                likelihoods,
                temper=candidate.temper,
                preference=candidate.preference,
                detail_temper=candidate.detail_temper,
            )
            with limited_threads(torch.get_num_threads()):
                known[candidate] = belief_scores(
                    stretches, candidate, likelihood, config=config or LocalizerConfig(), seed=seed
                )
            advance(len(known), max(total, len(known)))
        return known[candidate]

    changes: list[Change] = []

    def record(what: str, names: Sequence[str], before: Calibration, choice: Choice) -> None:
        changes.append(
            Change(
                what,
                {n: getattr(before, n) for n in names},
                {n: getattr(calibration, n) for n in names},
                choice.gain,
                choice.error,
                choice.preferred if choice.preferred != choice.value else None,
            )
        )

    for name, what in (("temper", "tempering β"), ("preference", "preference γ")):
        before = calibration
        calibration, choice = choose(name, calibration, score)
        record(what, [n for n in GRIDS if getattr(before, n) != getattr(calibration, n)] or [name], before, choice)
    before = calibration
    calibration, choice, coverage = choose_detail(calibration, score)
    what = "detail β_d" if coverage is None else f"detail β_d ({100 * coverage:.0f} % in the 95 % region)"
    record(what, ["detail_temper"], before, choice)
    return calibration, tuple(changes)
