"""Calibration of a network on held-out images: kernel widths, errors, and odometry."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
import torch
from scipy.optimize import minimize

from filtering.density import KernelDensity
from filtering.measurement_noise import Six
from filtering.se3 import Poses
from sequences.errors import SequenceError
from sequences.odometry_fit.fit import fit_odometry
from sequences.odometry_fit.pieces import LEAST_INCREMENTS
from sequences.odometry_fit.result import OdometryFit
from vapor.calibration.error_correlation import LEAST_IMAGES, Travel
from vapor.calibration.image_errors import LEAST_OUTLIERS, Change, fit_errors
from vapor.calibration.ood_model import EXEMPLARS
from vapor.calibration.places import Observations
from vapor.checkpoints.calibration import Calibration
from vapor.checkpoints.scene_scale import log_clutter_density, scene_extent, spaced
from vapor.evaluation.reliability import Reliability
from vapor.evaluation.seen_images import describe_images
from vapor.evaluation.validation import predict
from vapor.landmarks.build import Advance
from vapor.regressors.base import PoseRegressor
from vapor.regressors.ood_model import OodModel
from vapor.threads import limited_threads
from vapor.training_data.ground import odometry_segments, pass_numbers, some_runs
from vapor.training_data.training_set import TrainingSet

_NARROWEST, _WIDEST = (5e-4, 3e-3), (0.1, 1.0)  # kernels: extents, radians
_BLOCK = 50  # images at a time: 50 × 2000 float32 fit the cache
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
