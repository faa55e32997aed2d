"""Calibration of a model file on held-out images that it was not trained on, of its own place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from filtering.errors import VaporTrackError
from filtering.se3 import Poses
from sequences.options import SequenceOptions
from vapor.calibration.calibrate import CalibrationResult, calibrate
from vapor.calibration.error_correlation import LEAST_IMAGES
from vapor.calibration.image_errors import ordinary_score
from vapor.calibration.ood_model import EXEMPLARS, learn_ood_model
from vapor.checkpoints.file_format import find_model, load_checkpoint, save_checkpoint
from vapor.checkpoints.scene_scale import spaced
from vapor.checkpoints.stored_tensors import NETWORK
from vapor.engines.engine import Device, resolve_device
from vapor.evaluation.seen_images import describe_images
from vapor.evaluation.trained_images import count_trained_images, said_of_trained_images
from vapor.landmarks.build import Advance
from vapor.regressors.base import PoseRegressor
from vapor.regressors.ood_model import OodModel
from vapor.tensor_files import read_safetensors
from vapor.training_data.entries import open_sequences, require_no_leakage
from vapor.training_data.load import load_training_set
from vapor.training_data.training_set import TrainingSet

_MOST_TRAINED = 0.5  # of the held-out images
_LEAST_RIGHT = 0.02  # of them: fewer are right by chance, in a place that the model does not know


def calibrate_model(
    model: str,
    data: Sequence[Path | str],
    output: Path | str,
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
    """Calibrate a trained model, and write it with the same weights.

    The OOD model is learned from `training`. Without it, only the threshold of the model's OOD model is fitted; where
    the model has none, it is learned from half of the held-out data, and the threshold from the rest.

    Args:
        model: Model file, or name of a model that ships.
        data: Held-out files and folders with true poses, as for `train`.
        output: The model file to write.
        training: Data that the model was trained on, or some of it.
        ood_only: Fit only the OOD model.
        same_conditions: See `calibrate`.
        max_images: Greatest number of held-out images that are used.
        seed: Seed of latent noise.
        device: Device of the network.
        reading: Options of reading MCAP sequences; None for the defaults.
        advance: Called with the number of images seen by the network, and of all.

    Raises:
        VaporTrackError: unusable model or data, too little of it to calibrate anything, images most of which the model
            was trained on, or images of which hardly any is localized.

    Example:
        >>> import vapor
        >>> result = vapor.calibrate_model("place.safetensors", ["walk3.mcap"], "calibrated.safetensors")
        >>> len(result.calibration.errors.typical_std)  # of an ordinary image, metres and radians
        6
    """
    file, output = find_model(model), Path(output)
    if output.is_dir() or not output.parent.is_dir():
        raise VaporTrackError(f"{output}: cannot be written, expected the name of a model file in an existing folder")
    checkpoint = load_checkpoint(file)
    config = checkpoint.network
    require_no_leakage(training, data)
    odometry = "unread" if ood_only else "optional"

    def load(entries: Sequence[Path | str]) -> TrainingSet:
        sequences = open_sequences(entries, reading, odometry, checkpoint.cameras)
        return load_training_set(sequences, config.frame_size, camera=checkpoint.camera)

    held_out = load(data)
    trained_on = load(training) if training else None
    names = ", ".join(Path(str(entry)).name for entry in data)
    if len(held_out) < LEAST_IMAGES:
        raise VaporTrackError(f"{names}: {len(held_out)} images with true poses, expected at least {LEAST_IMAGES}")
    notice = _said_of_trained_images(held_out, checkpoint.description.memory_poses, names)
    skipped = held_out.skipped + trained_on.skipped if trained_on else held_out.skipped
    notices = (*notice, *held_out.notices, *(trained_on.notices if trained_on else ()))
    network = checkpoint.build_network().to(resolve_device(device))
    ood_model = _ood_model(network, checkpoint.ood_model, trained_on, held_out, max_images)
    calibration, known = checkpoint.calibration, checkpoint.ood_model
    if ood_model is not None and known is not None:
        # Scores have another scale now; an ordinary image is as ordinary as before.
        if trained_on is None:
            scores = np.array([calibration.errors.typical_ood_score * known.threshold / ood_model.threshold])
        else:
            features = describe_images(network, held_out.select(spaced(len(held_out), max_images)))
            scores = ood_model.ood_score(features)
        noise = replace(calibration.errors, typical_ood_score=ordinary_score(scores))
        calibration = replace(calibration, errors=noise)
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
        _refuse_another_place(result, names)
        own = {"data": [Path(str(entry)).name for entry in data], **result.provenance}
        provenance = {**checkpoint.training, "calibration": own}
    fitted = replace(checkpoint, calibration=result.calibration, training=provenance, ood_model=ood_model)
    stored = read_safetensors(file)[1].items()
    float16 = any(tensor.dtype == torch.float16 for name, tensor in stored if name.startswith(NETWORK))
    save_checkpoint(output, fitted, store_float16=float16)
    return replace(result, skipped=skipped, notices=notices)


def _said_of_trained_images(held_out: TrainingSet, trained: Poses | None, names: str) -> list[str]:
    """Notice where some held-out images were trained on; an error where most were."""
    if trained is None:
        return []
    count = count_trained_images(held_out.poses, trained)
    if count > _MOST_TRAINED * len(held_out):
        raise VaporTrackError(
            f"{names}: the model was trained on {count} of the {len(held_out)} images, by their true poses, and knows"
            " them better than new ones; expected images that it was not trained on"
        )
    said = said_of_trained_images([held_out.poses[i] for i in range(len(held_out))], trained)
    return [] if said is None else [said]


def _refuse_another_place(result: CalibrationResult, names: str) -> None:
    if (reliability := result.reliability) is None or reliability.right >= _LEAST_RIGHT:
        return
    raise VaporTrackError(
        f"{names}: the best place of a single image is the true one in {100 * reliability.right:.0f} % of"
        f" {result.images} images, expected at least {100 * _LEAST_RIGHT:.0f} %; are they of another place than the"
        " model's, or their true poses in another frame?"
    )


def _ood_model(
    network: PoseRegressor,
    known: OodModel | None,
    trained_on: TrainingSet | None,
    held_out: TrainingSet,
    max_images: int,
) -> OodModel | None:
    """The OOD model with the threshold of held-out images; None where there are too few images."""
    if trained_on is None and known is not None:
        return known.with_threshold_of(describe_images(network, held_out.select(spaced(len(held_out), max_images))))
    if trained_on is None:
        numbers, which = np.unique(held_out.sequence, return_inverse=True)
        first = which % 2 == 0 if len(numbers) > 1 else np.arange(len(held_out)) < len(held_out) // 2
        trained_on, held_out = held_out.select(np.flatnonzero(first)), held_out.select(np.flatnonzero(~first))
    some = trained_on.select(spaced(len(trained_on), EXEMPLARS))
    return learn_ood_model(network, some, held_out.select(spaced(len(held_out), max_images)))
