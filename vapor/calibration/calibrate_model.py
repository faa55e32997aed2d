"""Calibration of a model file on held-out recordings: another file with the same weights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from filtering.errors import VaporTrackError
from sequences.options import SequenceOptions
from vapor.calibration.calibrate import Advance, CalibrationResult, calibrate
from vapor.calibration.image_errors import LEAST_IMAGES, ordinary_score
from vapor.calibration.ood_model import EXEMPLARS, extract_features, learn_ood_model
from vapor.checkpoints.file_format import find_model, load_checkpoint, save_checkpoint
from vapor.checkpoints.scene_scale import spaced
from vapor.checkpoints.stored_tensors import NETWORK
from vapor.engines.engine import Device, resolve_device
from vapor.regressors.base import PoseRegressor
from vapor.regressors.ood_model import OodModel
from vapor.tensor_files import read_safetensors
from vapor.training_data.entries import open_sequences, require_no_leakage
from vapor.training_data.load import load_training_set
from vapor.training_data.training_set import TrainingSet


def calibrate_model(
    model: str,
    data: Sequence[Path | str],
    output: Path,
    *,
    training: Sequence[Path | str] = (),
    ood_only: bool = False,
    same_conditions: bool = False,
    max_images: int = 500,
    seed: int = 0,
    device: Device = "auto",
    reading: SequenceOptions | None = None,
    advance: Advance = lambda done, total: None,
) -> CalibrationResult:
    """Calibrate a trained model, and write it with its weights untouched.

    The OOD model is learned from `training`. Without it, only the threshold of a known one is fitted; an unknown
    one is learned from half of the held-out data, and the threshold from the rest.

    Args:
        model: Model file, or name of a model that ships.
        data: Held-out files and folders with true poses, as for `train`.
        output: The model file to write.
        training: Data that the model was trained on, or some of it.
        ood_only: Fit only the OOD model.
        same_conditions: As in `calibrate`.
        max_images: Number of held-out images that are used, at most.
        seed: Of latent noise.
        device: Where the network runs.
        reading: Options of reading MCAP sequences; None for the defaults.
        advance: Called with the number of images seen by the network, and of all.

    Raises:
        VaporTrackError: unusable model or data, or too little of it to calibrate anything.
    """
    file, output = find_model(model), Path(output)
    if output.is_dir() or not output.parent.is_dir():
        raise VaporTrackError(f"{output}: cannot be written, expected the name of a model file in an existing folder")
    checkpoint = load_checkpoint(file)
    config = checkpoint.network
    require_no_leakage(training, data)
    odometry = "unread" if ood_only else "optional"

    def load(entries: Sequence[Path | str]) -> TrainingSet:
        sequences = open_sequences(entries, reading, odometry)
        return load_training_set(sequences, config.frame_size, camera=checkpoint.camera)

    held_out = load(data)
    trained_on = load(training) if training else None
    if len(held_out) < LEAST_IMAGES:
        names = ", ".join(Path(str(entry)).name for entry in data)
        raise VaporTrackError(f"{names}: {len(held_out)} images with true poses, expected at least {LEAST_IMAGES}")
    skipped = held_out.skipped + trained_on.skipped if trained_on else held_out.skipped
    notices = held_out.notices + (trained_on.notices if trained_on else ())
    network = checkpoint.build_network().to(resolve_device(device))
    ood_model = _ood_model(network, checkpoint.ood_model, trained_on, held_out, max_images)
    calibration, known = checkpoint.calibration, checkpoint.ood_model
    if ood_model is not None and known is not None:
        # Scores have another scale now; an ordinary image is as ordinary as before.
        if trained_on is None:
            scores = np.array([calibration.errors.typical_ood_score * known.threshold / ood_model.threshold])
        else:
            features = extract_features(network, held_out.select(spaced(len(held_out), max_images)))
            scores = ood_model.ood_score(features)
        errors = replace(calibration.errors, typical_ood_score=ordinary_score(scores))
        calibration = replace(calibration, errors=errors)
    if ood_only:
        result, provenance = CalibrationResult(calibration), checkpoint.training
    else:
        result = calibrate(
            network,
            held_out,
            checkpoint.prior_poses,
            calibration,
            training=trained_on,
            ood_model=ood_model,
            same_conditions=same_conditions,
            max_images=max_images,
            seed=seed,
            advance=advance,
        )
        names = {"data": [Path(str(entry)).name for entry in data]}
        provenance = {**checkpoint.training, "calibration": names | result.provenance}
    fitted = replace(checkpoint, calibration=result.calibration, training=provenance, ood_model=ood_model)
    stored = read_safetensors(file)[1].items()
    float16 = any(tensor.dtype == torch.float16 for name, tensor in stored if name.startswith(NETWORK))
    save_checkpoint(output, fitted, store_float16=float16)
    return replace(result, skipped=skipped, notices=notices)


def _ood_model(
    network: PoseRegressor,
    known: OodModel | None,
    trained_on: TrainingSet | None,
    held_out: TrainingSet,
    max_images: int,
) -> OodModel | None:
    """The OOD model with the threshold of held-out images; None where there are too few images."""
    if trained_on is None and known is not None:
        return known.with_threshold_of(extract_features(network, held_out.select(spaced(len(held_out), max_images))))
    if trained_on is None:
        numbers, which = np.unique(held_out.sequence, return_inverse=True)
        first = which % 2 == 0 if len(numbers) > 1 else np.arange(len(held_out)) < len(held_out) // 2
        trained_on, held_out = held_out.select(np.flatnonzero(first)), held_out.select(np.flatnonzero(~first))
    some = trained_on.select(spaced(len(trained_on), EXEMPLARS))
    return learn_ood_model(network, some, held_out.select(spaced(len(held_out), max_images)))
