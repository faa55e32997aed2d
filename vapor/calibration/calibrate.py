"""Calibration of a trained network on held-out images: how its posteriors err, and the odometry of its scene."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Int64

from filtering.errors import VaporTrackError
from filtering.se3 import Poses
from sequences.errors import SequenceError
from sequences.odometry_fit.fit import fit_odometry
from sequences.odometry_fit.pieces import LEAST_INCREMENTS
from sequences.odometry_fit.result import OdometryFit
from sequences.options import SequenceOptions
from vapor.calibration.familiarity import EXEMPLARS, describe, learn_familiarity
from vapor.calibration.images import LEAST_IMAGES, Change, Seen, Way, fit_errors, fit_widths, ordinary_score
from vapor.checkpoints.checkpoint import (
    NETWORK,
    Calibration,
    Checkpoint,
    find_model,
    load_checkpoint,
    save_checkpoint,
    spaced,
)
from vapor.evaluation.validation import predict
from vapor.observation import Device, resolve_device
from vapor.regressors.base import PoseRegressor
from vapor.regressors.familiarity import Familiarity
from vapor.tensor_files import read_safetensors
from vapor.threads import limited_threads
from vapor.training_data.passes import odometry_stretches, pass_numbers, some_runs
from vapor.training_data.training_set import TrainingSet, load_training_set, open_sequences, require_apart

NUM_SAMPLES = 1000  # an image, as in use: fewer want wider kernels

Advance = Callable[[int, int], None]


@dataclass(frozen=True)
class CalibrationResult:
    """A calibration and where it comes from.

    Attributes:
        calibration: The values.
        changes: One for each fit.
        images: Held-out images that they are fitted on; 0 where there were too few.
        effective_images: So many independent images are worth as much.
        coverage: Share of these images whose true pose lies in the 50, 90 and 95 % region of the place of its posterior
            in which it is likeliest; None where nothing was fitted.
        odometry: Where the noise of the odometry was found: "held-out data", "training data" or "none".
        notes: What was kept, and why.
        skipped: Images and poses of the data that were left out in reading, by reason.
        notices: What a person should know of the model's file and of the data.
    """

    calibration: Calibration
    changes: tuple[Change, ...] = ()
    images: int = 0
    effective_images: float = 0.0
    coverage: tuple[float, float, float] | None = None
    odometry: str = "none"
    notes: tuple[str, ...] = ()
    skipped: Mapping[str, int] = field(default_factory=dict)
    notices: tuple[str, ...] = ()

    @property
    def provenance(self) -> dict[str, Any]:
        """JSON for the model file: all but the values themselves and what was left out."""
        return {key: value for key, value in asdict(self).items() if key not in ("calibration", "skipped", "notices")}


def calibrate_model(
    model: str,
    data: Sequence[Path | str],
    output: Path,
    *,
    training: Sequence[Path | str] = (),
    familiarity_only: bool = False,
    same_conditions: bool = False,
    max_images: int = 500,
    seed: int = 0,
    device: Device = "auto",
    reading: SequenceOptions | None = None,
    advance: Advance = lambda done, total: None,
) -> CalibrationResult:
    """Calibrate a model that was trained before, and write it with its weights untouched.

    What is familiar to the network is learned from `training`; without it what the model says of that stays, but for
    its threshold. A model that says nothing learns it from half of the held-out data, and the threshold from the rest.

    Args:
        model: Model file, or name of a model that ships.
        data: Held-out files and folders with true poses, as for `train`.
        output: The model file to write.
        training: Data that the model was trained on, or some of it.
        familiarity_only: Fit nothing but that.
        same_conditions: As of `calibrate`.
        max_images: Held-out images of the fits, at most.
        seed: Of latent noise.
        device: Where the network runs.
        reading: What to read of MCAP sequences, of both; None for all of it, as found.
        advance: Called with the number of images seen by the network and of all.

    Raises:
        VaporTrackError: unusable model or data, or too little of it to calibrate anything.
    """
    file, output = find_model(model), Path(output)
    if output.is_dir() or not output.parent.is_dir():
        raise VaporTrackError(f"{output}: cannot be written, expected the name of a model file in an existing folder")
    checkpoint = load_checkpoint(file)
    config = checkpoint.network
    require_apart(training, data)
    odometry = "unread" if familiarity_only else "optional"
    held_out = load_training_set(open_sequences(data, reading, odometry), config.frame_size, camera=checkpoint.camera)
    trained_on = (
        load_training_set(open_sequences(training, reading, odometry), config.frame_size, camera=checkpoint.camera)
        if training
        else None
    )
    if len(held_out) < LEAST_IMAGES:
        names = ", ".join(Path(str(entry)).name for entry in data)
        raise VaporTrackError(f"{names}: {len(held_out)} images with true poses, expected at least {LEAST_IMAGES}")
    skipped = held_out.skipped + trained_on.skipped if trained_on else held_out.skipped
    notices = checkpoint.notices + held_out.notices + (trained_on.notices if trained_on else ())
    network = checkpoint.build_network().to(resolve_device(device))
    familiarity = _familiarity(network, checkpoint.familiarity, trained_on, held_out, max_images)
    calibration, known = checkpoint.calibration, checkpoint.familiarity
    if familiarity is not None and known is not None:
        # Scores are other ones now; an ordinary image is as ordinary as before.
        if trained_on is None:
            scores = np.array([calibration.errors.unfamiliar_score * known.threshold / familiarity.threshold])
        else:
            judged = describe(network, held_out.select(spaced(len(held_out), max_images)))
            scores = familiarity.unfamiliarity(judged)
        errors = replace(calibration.errors, unfamiliar_score=ordinary_score(scores))
        calibration = replace(calibration, errors=errors)
    if familiarity_only:
        _save(replace(checkpoint, familiarity=familiarity, calibration=calibration), output, file)
        return CalibrationResult(calibration, skipped=skipped, notices=notices)
    result = calibrate(
        network,
        held_out,
        checkpoint.prior_poses,
        calibration,
        training=trained_on,
        familiarity=familiarity,
        same_conditions=same_conditions,
        max_images=max_images,
        seed=seed,
        advance=advance,
    )
    names = {"data": [Path(str(entry)).name for entry in data]}
    provenance = {**checkpoint.training, "calibration": names | result.provenance}
    fitted = replace(checkpoint, calibration=result.calibration, training=provenance, familiarity=familiarity)
    _save(fitted, output, file)
    return replace(result, skipped=skipped, notices=notices)


def _save(checkpoint: Checkpoint, output: Path, source: Path) -> None:
    """Write it, its network's weights as they were stored in the file that they come from."""
    stored = read_safetensors(source)[1].items()
    half = any(tensor.dtype == torch.float16 for name, tensor in stored if name.startswith(NETWORK))
    save_checkpoint(output, checkpoint, half=half)


def _familiarity(
    network: PoseRegressor,
    known: Familiarity | None,
    trained_on: TrainingSet | None,
    held_out: TrainingSet,
    max_images: int,
) -> Familiarity | None:
    """What is familiar to a network, judged by held-out images; None where there are too few."""
    if trained_on is None and known is not None:
        return known.with_threshold_of(describe(network, held_out.select(spaced(len(held_out), max_images))))
    if trained_on is None:
        first = _first_half(held_out.sequence)
        trained_on, held_out = held_out.select(np.flatnonzero(first)), held_out.select(np.flatnonzero(~first))
    some = trained_on.select(spaced(len(trained_on), EXEMPLARS))
    return learn_familiarity(network, some, held_out.select(spaced(len(held_out), max_images)))


def _first_half(sequence: Int64[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Every other sequence; of a single one the first half."""
    numbers, which = np.unique(sequence, return_inverse=True)
    return which % 2 == 0 if len(numbers) > 1 else np.arange(len(sequence)) < len(sequence) // 2


def calibrate(
    network: PoseRegressor,
    held_out: TrainingSet,
    prior_poses: Poses,
    calibration: Calibration,
    *,
    training: TrainingSet | None = None,
    familiarity: Familiarity | None = None,
    same_conditions: bool = False,
    max_images: int,
    seed: int,
    advance: Advance = lambda done, total: None,
) -> CalibrationResult:
    """Fit kernel widths and how posteriors err, and the noise of odometry where true poses come with some.

    Args:
        network: With its final weights.
        held_out: Images that it was not trained on, in order of time.
        prior_poses: Of the model, (n,): they outline the scene.
        calibration: Values to start from, and to keep where there is too little data.
        training: Data that it was trained on: their odometry is used where the held-out data have too little of it.
        familiarity: What is familiar to it: unfamiliar images err more, as held-out and trained ones tell together.
        same_conditions: Whether held-out images are of the hours, the light and the seasons of use: mistakes about the
            place then last as long as on them; else they are taken to last longer.
        max_images: At most so many images are used; of the odometry all.
        seed: Of latent noise.
        advance: Called with the number of images seen by the network and of all.
    """
    odometry, source = _odometry({"held-out data": held_out, "training data": training})
    calibration = replace(calibration, odometry=odometry or calibration.odometry)
    if len(held_out) < LEAST_IMAGES:
        note = (
            f"{len(held_out)} held-out images, at least {LEAST_IMAGES} are needed: errors of images kept as they were"
        )
        return CalibrationResult(calibration, odometry=source, notes=(note,))
    chosen = some_runs(len(held_out), max(max_images, LEAST_IMAGES))
    looked = [held_out.select(chosen)]
    if training is not None and familiarity is not None and network.memory is None:  # which errs on no image of it
        exemplars = spaced(len(training), EXEMPLARS)
        looked.append(training.select(exemplars[spaced(len(exemplars), len(chosen))]))
    total, done, seen = sum(len(images) for images in looked), 0, []
    for images in looked:
        samples = []
        for poses in predict(network, images, NUM_SAMPLES, seed):
            samples.append(poses)
            advance(done + len(samples), total)
        done += len(samples)
        score = familiarity.unfamiliarity(describe(network, images)) if familiarity is not None else None
        seen.append(Seen(samples, images.poses, score))
    samples, truth = seen[0].samples, seen[0].truth
    way = Way.along(held_out.poses, pass_numbers(held_out))[chosen]
    scene = Poses.concatenate([prior_poses, truth])
    with limited_threads(torch.get_num_threads()):
        before = calibration.bandwidth_translation_m, calibration.bandwidth_rotation_rad
        widths, wider = fit_widths(samples, truth, scene, before)
        trained = seen[1] if len(seen) > 1 else None
        fit = fit_errors(seen[0], way, scene, calibration.errors, trained=trained, same_conditions=same_conditions)
    return CalibrationResult(
        Calibration(*widths, fit.errors, calibration.odometry),
        (wider, *fit.changes),
        len(chosen),
        fit.effective_images,
        fit.coverage,
        source,
    )


def _odometry(data: Mapping[str, TrainingSet | None]) -> tuple[OdometryFit | None, str]:
    """How wrong odometry is on the first data that have enough of it, and the name of these."""
    for name, images in data.items():
        stretches = odometry_stretches(images) if images is not None else []
        if sum(len(stretch.odometry) for stretch in stretches) < LEAST_INCREMENTS:
            continue
        try:
            return fit_odometry(stretches), name
        except SequenceError:  # of increments that take no time
            continue
    return None, "none"
