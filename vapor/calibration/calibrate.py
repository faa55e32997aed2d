"""Calibration of a network on held-out images: kernel widths, its errors, and the odometry of its scene."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
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
from vapor.calibration.error_correlation import Travel
from vapor.calibration.image_errors import LEAST_IMAGES, LEAST_OUTLIERS, Change, fit_errors
from vapor.calibration.ood_model import EXEMPLARS, extract_features
from vapor.calibration.places import Observations
from vapor.checkpoints.calibration import Calibration
from vapor.checkpoints.scene_scale import log_clutter_density, scene_extent, spaced
from vapor.evaluation.validation import predict
from vapor.regressors.base import PoseRegressor
from vapor.regressors.ood_model import OodModel
from vapor.threads import limited_threads
from vapor.training_data.ground import odometry_segments, pass_numbers, some_runs
from vapor.training_data.training_set import TrainingSet

_NARROWEST, _WIDEST = (5e-4, 3e-3), (0.1, 1.0)  # kernels: extents, radians
_BLOCK = 50  # images at a time: 50 × 2000 float32 fit the cache
NUM_SAMPLES = 1000  # an image, as in use: fewer want wider kernels


def fit_first_odometry(data: Mapping[str, TrainingSet | None]) -> tuple[OdometryFit | None, str]:
    """The errors of odometry on the first data that have enough of it, and their name; else None and "none"."""
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


Advance = Callable[[int, int], None]


@dataclass(frozen=True)
class CalibrationResult:
    """A calibration and its provenance.

    Attributes:
        calibration: The values.
        changes: One for each fit.
        images: Number of held-out images of the fit; 0 where there were too few.
        effective_images: Number of independent images with as much information.
        coverage: Fractions of these images whose true pose is in the 50, 90 and 95 % region of its likeliest place.
        odometry: Source of the odometry's noise: "held-out data", "training data" or "none".
        notes: Values that were kept, and the reason.
        skipped: Images and poses that were skipped in reading, by reason.
        notices: Notices about the model file and the data, for a person.
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
        network: With its final weights.
        held_out: Images that it was not trained on, in order of time.
        prior_poses: The model's, (n,): they outline the scene.
        calibration: Initial values, kept where there is too little data.
        training: Its training data; their odometry is used where the held-out data have too little of it.
        ood_model: Scores images; errors grow with the score.
        same_conditions: Whether held-out images show the light and season of use; else mistakes about the place are
            taken to last longer than on them.
        max_images: Number of images that are used, at most; of the odometry all is used.
        seed: Of latent noise.
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
    if training is not None and ood_model is not None and network.memory is None:  # which errs on no image of it
        exemplars = spaced(len(training), EXEMPLARS)
        observed.append(training.select(exemplars[spaced(len(exemplars), len(chosen))]))
    total, done, found = sum(len(images) for images in observed), 0, []
    for images in observed:
        samples = []
        for poses in predict(network, images, NUM_SAMPLES, seed):
            samples.append(poses)
            advance(done + len(samples), total)
        done += len(samples)
        score = ood_model.ood_score(extract_features(network, images)) if ood_model is not None else None
        found.append(Observations(samples, images.poses, score))
    samples, truth = found[0].samples, found[0].truth
    travel = Travel.along(held_out.poses, pass_numbers(held_out))[chosen]
    scene = Poses.concatenate([prior_poses, truth])
    with limited_threads(torch.get_num_threads()):
        before = calibration.bandwidth_translation_m, calibration.bandwidth_rotation_rad
        widths, wider = fit_widths(samples, truth, scene, before)
        trained = found[1] if len(found) > 1 else None
        fit = fit_errors(found[0], travel, scene, calibration.errors, trained=trained, same_conditions=same_conditions)
    return CalibrationResult(
        Calibration(*widths, fit.errors, calibration.odometry),
        (wider, *fit.changes),
        len(chosen),
        fit.effective_images,
        fit.coverage,
        source,
    )
