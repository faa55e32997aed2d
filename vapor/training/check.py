"""The check of a new model on its held-out passes: the filter beside the single image; larger errors where needed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int64

from filtering.config import LocalizerConfig
from filtering.measurement_noise import MeasurementNoise
from filtering.motion import Odometry
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from filtering.training_prior import TrainingPrior
from sequences.odometry_fit.result import OdometryFit
from vapor.calibration.calibrate import CalibrationResult, predict_all
from vapor.checkpoints.calibration import Calibration
from vapor.checkpoints.scene_scale import default_errors
from vapor.evaluation.consistency import REGIONS, evaluate_belief
from vapor.evaluation.seen_images import describe_images
from vapor.evaluation.trajectory import is_right
from vapor.landmarks.localize import VerifiedPose
from vapor.landmarks.verify import verified
from vapor.regressors.base import PoseRegressor
from vapor.regressors.ood_model import OodModel
from vapor.tracking.follow import Followed, Segment, follow, posterior_of
from vapor.training.landmarks import HeldOutLandmarks
from vapor.training.progress import Figures, TrainingCheck, verdict
from vapor.training_data.training_set import TrainingSet

METHODS = ("single_image", "kalman", "filter", "smoothed")
LEAST_PASS = 20  # images
_MOST_IMAGES = 600
_LEAST_EVALUATED = 50
_WIDER = (2.0, 4.0, 8.0, 16.0)  # factors of the variances that are tried


def check(
    network: PoseRegressor,
    images: TrainingSet,
    held_out: Bool[np.ndarray, " n"],
    result: CalibrationResult,
    ood_model: OodModel | None,
    scene: Poses,
    landmarks: HeldOutLandmarks | None = None,
    *,
    seed: int,
    advance: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[TrainingCheck | None, Calibration]:
    """Run the filter over held-out passes, and choose errors with which it is no worse than the single image.

    Args:
        network: The network with its final weights.
        images: n images of recordings that have held-out images.
        held_out: Mask of the held-out images, (n,).
        result: Calibration of the network.
        ood_model: OOD model of the network, if any.
        scene: Prior poses of the model, which outline the scene.
        landmarks: Landmarks of the training images, if any.
        seed: Seed of latent noise and of the filter's draws.
        advance: Called with the number of images done and of all.

    Returns:
        The check, or None without `LEAST_PASS` consecutive images with odometry; and the calibration to keep.
    """
    fitted = result.calibration
    runs = list(_runs(images, held_out))
    if not runs:
        return None, fitted
    runs = [(rows[: max(_MOST_IMAGES // len(runs), LEAST_PASS)], odometry) for rows, odometry in runs]
    parts = [images.select(rows) for rows, _ in runs]
    passes, prior = [], TrainingPrior(scene, fitted.errors.radius_m, fitted.errors.radius_rad)
    for (rows, odometry), some, samples in zip(runs, parts, predict_all(network, parts, seed, advance), strict=True):
        scores = ood_model.ood_score(describe_images(network, some)) if ood_model else np.zeros(len(rows))
        found_poses: list[Sequence[VerifiedPose]] = [() for _ in rows]
        if landmarks is not None:
            for i, row in enumerate(rows.tolist()):
                coarse = posterior_of(samples[i], fitted.errors, float(scores[i]), prior)
                found_poses[i] = landmarks.found(images, row, coarse)
        passes.append(_Pass(some, odometry[: len(rows)], samples, scores, found_poses))

    candidates = [(1.0, False, fitted.errors)]
    candidates += [(factor, False, _inflated(fitted.errors, factor)) for factor in _WIDER]
    candidates.append((1.0, True, replace(default_errors(scene), verified=fitted.errors.verified)))
    found, followed, kept = None, [], fitted.errors
    for inflation, assumed, noise in candidates:
        prior = TrainingPrior(scene, noise.radius_m, noise.radius_rad)
        again = [each.followed(noise, prior, fitted.odometry, landmarks, seed) for each in passes]
        other = replace(_summed(again), inflation=inflation, assumed=assumed)
        if found is None or other.rank > found.rank:
            found, followed, kept = other, again, noise
        if not (found.worse or found.overconfident):
            break
    assert found is not None
    smoothed = [each.hindsight.best.poses for each in followed]
    found = replace(found, methods={**found.methods, "smoothed": _figures(followed, smoothed)})
    return replace(found, verdict=verdict(found, result)), replace(fitted, errors=kept)


@dataclass(frozen=True)
class _Pass:
    """A held-out pass, with the results of network and landmarks for each of its images."""

    images: TrainingSet
    odometry: tuple[Odometry | None, ...]
    samples: list[Poses]
    scores: Float64[np.ndarray, " n"]
    verified_poses: list[Sequence[VerifiedPose]]

    def followed(
        self,
        noise: MeasurementNoise,
        prior: TrainingPrior,
        fit: OdometryFit | None,
        landmarks: HeldOutLandmarks | None,
        seed: int,
    ) -> Followed:
        """The filter along the pass, with these errors of images."""
        config = LocalizerConfig() if fit is None else replace(LocalizerConfig(), odometry_bias=fit.odometry_bias)

        def posterior(image: int) -> PosePosterior:
            coarse = posterior_of(self.samples[image], noise, float(self.scores[image]), prior)
            if landmarks is None:
                return coarse
            return verified(coarse, self.verified_poses[image], landmarks.verification, landmarks.mapped)

        segment = Segment(self.images.times_ns, self.odometry, self.images.poses, posterior).restated(fit)
        return follow(segment, noise, config, rng=np.random.default_rng(seed), baselines=("kalman",))


def _inflated(noise: MeasurementNoise, factor: float) -> MeasurementNoise:
    """Errors of all places, verified ones too, with larger variances."""
    verified_errors = None if noise.verified is None else noise.verified.inflated(factor)
    return replace(noise.inflated(factor), verified=verified_errors)


def _runs(
    images: TrainingSet, held_out: Bool[np.ndarray, " n"]
) -> Iterator[tuple[Int64[np.ndarray, " k"], tuple[Odometry | None, ...]]]:
    """Runs of held-out images that odometry connects, and the motion to each image from the previous one."""
    rows: list[int] = []
    motions: list[Odometry | None] = []
    for row in np.flatnonzero(held_out).tolist():
        motion = _between(images, rows[-1], row) if rows else None
        if motion is None:
            if len(rows) >= LEAST_PASS:
                yield np.array(rows), tuple(motions)
            rows, motions = [], []
        rows.append(row)
        motions.append(motion)
    if len(rows) >= LEAST_PASS:
        yield np.array(rows), tuple(motions)


def _between(images: TrainingSet, first: int, last: int) -> Odometry | None:
    """Motion from one image to a later one; None where odometry is missing in between."""
    found: Odometry | None = None
    for step in images.odometry[first + 1 : last + 1]:
        if step is None:
            return None
        found = step if found is None else found.then(step)
    return found


def _summed(followed: Sequence[Followed]) -> TrainingCheck:
    """Figures of all methods but the smoothed trajectory, which decides nothing."""
    methods = {name: _figures(followed, [each.poses[name] for each in followed]) for name in METHODS[:-1]}
    segments = [each.segment for each in followed]
    called = [
        evaluate_belief(each.beliefs["filter"], of.times_ns, of.truth, converged_at_s=None, kidnap_index=None)[
            "converged_images"
        ]
        for each, of in zip(followed, segments, strict=True)
    ]
    called = [each for each in called if each["images"]]
    images, converged = sum(len(each.times_ns) for each in segments), sum(each["images"] for each in called)

    def fraction(of: Callable[[Mapping[str, Any]], float]) -> float:
        return sum(each["images"] * of(each) for each in called) / converged

    return TrainingCheck(
        images,
        len(segments),
        methods,
        converged / images,
        fraction(lambda each: each["wrong"]) if called else None,
        {name: fraction(lambda each, name=name: each["coverage"][name]) for name in REGIONS}
        if converged >= _LEAST_EVALUATED
        else None,
    )


def _figures(followed: Sequence[Followed], poses: Sequence[Poses]) -> Figures:
    segments = [(found, each.segment.truth) for found, each in zip(poses, followed, strict=True)]
    apart = [found.distance(truth) for found, truth in segments]
    moved_m, turned = (np.concatenate(part) for part in zip(*apart, strict=True))
    right = np.concatenate([is_right(found, truth) for found, truth in segments])
    return Figures(float(np.median(moved_m)), float(np.degrees(np.median(turned))), float(np.mean(right)))
