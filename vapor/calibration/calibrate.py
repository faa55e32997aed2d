"""Calibration of a network, or of a model file, on held-out images: kernel widths, errors, and odometry."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.optimize import minimize

from filtering.density import KernelDensity
from filtering.errors import VaporTrackError
from filtering.measurement_noise import Six
from filtering.se3 import Poses
from sequences.errors import SequenceError
from sequences.odometry_fit.fit import fit_odometry
from sequences.odometry_fit.pieces import LEAST_INCREMENTS
from sequences.odometry_fit.result import OdometryFit
from sequences.options import SequenceOptions
from vapor.calibration.error_correlation import LEAST_IMAGES, Travel
from vapor.calibration.image_errors import LEAST_OUTLIERS, Change, fit_errors, ordinary_score
from vapor.calibration.ood_model import EXEMPLARS, learn_ood_model
from vapor.calibration.places import Observations
from vapor.checkpoints.calibration import Calibration
from vapor.checkpoints.file_format import find_model, load_checkpoint, save_checkpoint
from vapor.checkpoints.scene_scale import log_clutter_density, scene_extent, spaced
from vapor.checkpoints.stored_tensors import NETWORK
from vapor.engines.engine import Device, resolve_device
from vapor.evaluation.reliability import Reliability
from vapor.evaluation.seen_images import describe_images
from vapor.evaluation.trained_images import count_trained_images, said_of_trained_images
from vapor.evaluation.validation import predict
from vapor.landmarks.build import Advance
from vapor.regressors.base import PoseRegressor
from vapor.regressors.ood_model import OodModel
from vapor.tensor_files import read_safetensors
from vapor.threads import limited_threads
from vapor.training_data.entries import open_sequences, require_no_leakage
from vapor.training_data.ground import odometry_segments, pass_numbers, some_runs
from vapor.training_data.load import load_training_set
from vapor.training_data.training_set import TrainingSet

_NARROWEST, _WIDEST = (5e-4, 3e-3), (0.1, 1.0)  # kernels: extents, radians
_BLOCK = 50  # images at a time: 50 × 2000 float32 fit the cache
_MOST_TRAINED = 0.5  # of the held-out images
_LEAST_RIGHT = 0.02  # of them: fewer are right by chance, in a place that the model does not know
NUM_SAMPLES = 1000  # posterior samples an image, as in use: fewer need wider kernels


def fit_first_odometry(data: Mapping[str, TrainingSet | None]) -> tuple[OdometryFit | None, str]:
    """Errors of odometry on the first data with enough odometry, and their name; else None and "none"."""
    for name, images in data.items():
        segments = odometry_segments(images) if images is not None else []
        if sum(len(segment.odometry) for segment in segments) < LEAST_INCREMENTS:
            continue
        try:
            return fit_odometry(segments), name
        except SequenceError:  # the increments take no time
            continue
    return None, "none"


def fit_widths(
    samples: Sequence[Poses], truth: Poses, scene: Poses, before: tuple[float, float]
) -> tuple[tuple[float, float], Change]:
    """Kernel widths of posterior samples, metres and radians, of highest likelihood of the true poses."""
    apart = [poses.distance(truth[i]) for i, poses in enumerate(samples)]
    squared_m2 = np.array([np.square(metres) for metres, _ in apart], np.float32)
    squared_chord = np.array([2 - 2 * np.cos(radians) for _, radians in apart], np.float32)
    extent, log_flat = scene_extent(scene), np.log(LEAST_OUTLIERS) + log_clutter_density(scene)
    n, m = squared_m2.shape

    def score(widths: tuple[float, float]) -> float:
        log_sum = np.empty(n)
        scale_m, scale_rad = (np.float32(-0.5 / width**2) for width in widths)
        for start in range(0, n, _BLOCK):
            rows = slice(start, start + _BLOCK)
            exponent = squared_m2[rows] * scale_m
            exponent += squared_chord[rows] * scale_rad
            top = exponent.max(axis=1, keepdims=True)
            log_sum[rows] = top[:, 0] + np.log(np.exp(exponent - top).sum(axis=1), dtype=np.float64)
        kernel = KernelDensity(Poses.identity(1), *widths)
        log_density = log_sum - np.log(m) - kernel.log_normaliser[0]
        return float(np.logaddexp(log_flat, log_density + np.log1p(-LEAST_OUTLIERS)).mean())

    bounds = [(low * unit, high * unit) for low, high, unit in zip(_NARROWEST, _WIDEST, (extent, 1.0), strict=True)]
    found = minimize(
        lambda x: -score((float(np.exp(x[0])), float(np.exp(x[1])))),
        np.log([np.clip(value, *bound) for value, bound in zip(before, bounds, strict=True)]),
        method="Nelder-Mead",
        bounds=np.log(bounds),
        options={"xatol": 0.01, "fatol": 1e-4},
    )
    width_m, width_rad = (float(width) for width in np.exp(found.x))
    names = "bandwidth_translation_m", "bandwidth_rotation_rad"
    formerly: dict[str, float | Six] = dict(zip(names, before, strict=True))
    values: dict[str, float | Six] = dict(zip(names, (width_m, width_rad), strict=True))
    return (width_m, width_rad), Change("kernel widths", formerly, values, score((width_m, width_rad)) - score(before))


def predict_all(network: PoseRegressor, parts: Sequence[TrainingSet], seed: int, advance: Advance) -> list[list[Poses]]:
    """Posterior samples of all images of each part; `advance` is called with the number of images done and of all."""
    total, done = sum(len(images) for images in parts), 0
    found: list[list[Poses]] = [[] for _ in parts]
    for images, samples in zip(parts, found, strict=True):
        for poses in predict(network, images, NUM_SAMPLES, seed):
            samples.append(poses)
            done += 1
            advance(done, total)
    return found


@dataclass(frozen=True)
class CalibrationResult:
    """A calibration and its provenance.

    Attributes:
        calibration: The values.
        changes: Changes of the values, fit by fit.
        images: Number of held-out images of the fit; 0 where there were too few.
        effective_images: Number of independent images with the same information.
        coverage: Fractions of these images whose true pose is in the 50, 90 and 95 % region of its likeliest place.
        reliability: How often their best place is the true one, by its stated probability.
        weight_power: What the log ratio of two weights of a single image is worth, see `PlaceWeights.fitted_power`.
        odometry: Source of the odometry's noise: "held-out data", "training data" or "none".
        notes: Reasons for values that were kept.
        skipped: Number of images and poses that were skipped in reading, by reason.
        notices: Notices about the data for the user.
    """

    calibration: Calibration
    changes: tuple[Change, ...] = ()
    images: int = 0
    effective_images: float = 0.0
    coverage: tuple[float, float, float] | None = None
    reliability: Reliability | None = None
    weight_power: float = 0.0
    odometry: str = "none"
    notes: tuple[str, ...] = ()
    skipped: Mapping[str, int] = field(default_factory=dict)
    notices: tuple[str, ...] = ()

    @property
    def provenance(self) -> dict[str, Any]:
        """JSON for the model file: all but the values and the skipped images."""
        return {key: value for key, value in asdict(self).items() if key not in ("calibration", "skipped", "notices")}


def calibrate(
    network: PoseRegressor,
    held_out: TrainingSet,
    prior_poses: Poses,
    calibration: Calibration,
    *,
    training: TrainingSet | None = None,
    ood_model: OodModel | None = None,
    same_conditions: bool = False,
    max_images: int,
    seed: int,
    advance: Advance = lambda done, total: None,
) -> CalibrationResult:
    """Fit kernel widths and errors of posteriors, and the noise of odometry where true poses come with some.

    Args:
        network: The network with its final weights.
        held_out: Images that it was not trained on, in order of time.
        prior_poses: Prior poses of the model, (n,): they outline the scene.
        calibration: Initial values, kept where there is too little data.
        training: Its training data, whose odometry is used where the held-out data have too little odometry.
        ood_model: OOD model by whose score errors grow, if any.
        same_conditions: Whether held-out images show the light and season of use; else mistakes about the place are
            assumed to last longer than on them.
        max_images: Greatest number of images that are used; all odometry is used.
        seed: Seed of latent noise.
        advance: Called with the number of images seen by the network, and of all.
    """
    odometry, source = fit_first_odometry({"held-out data": held_out, "training data": training})
    calibration = replace(calibration, odometry=odometry or calibration.odometry)
    if len(held_out) < LEAST_IMAGES:
        note = (
            f"{len(held_out)} held-out images, at least {LEAST_IMAGES} are needed: errors of images kept as they were"
        )
        return CalibrationResult(calibration, odometry=source, notes=(note,))
    chosen = some_runs(len(held_out), max(max_images, LEAST_IMAGES))
    observed = [held_out.select(chosen)]
    # A network with a memory has no errors on its training images.
    if training is not None and ood_model is not None and network.memory is None:
        exemplars = spaced(len(training), EXEMPLARS)
        observed.append(training.select(exemplars[spaced(len(exemplars), len(chosen))]))
    found = []
    for images, samples in zip(observed, predict_all(network, observed, seed, advance), strict=True):
        score = ood_model.ood_score(describe_images(network, images)) if ood_model is not None else None
        found.append(Observations(samples, images.poses, score))
    samples, truth = found[0].samples, found[0].truth
    travel = Travel.along(held_out.poses, pass_numbers(held_out))[chosen]
    scene = Poses.concatenate([prior_poses, truth])
    with limited_threads(torch.get_num_threads()):
        before = calibration.bandwidth_translation_m, calibration.bandwidth_rotation_rad
        widths, wider = fit_widths(samples, truth, scene, before)
        trained = found[1] if len(found) > 1 else None
        fit = fit_errors(
            found[0],
            travel,
            scene,
            calibration.errors,
            trained=trained,
            training_poses=prior_poses,
            same_conditions=same_conditions,
        )
    return CalibrationResult(
        Calibration(*widths, fit.noise, calibration.odometry),
        (wider, *fit.changes),
        len(chosen),
        fit.effective_images,
        fit.coverage,
        fit.reliability,
        fit.weight_power,
        source,
    )


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
