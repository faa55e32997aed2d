"""Metrics of posteriors of single images against the truth: the paper's recall, and more."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from jaxtyping import Float64

from filtering.errors import VaporTrackError
from filtering.estimate import posterior_modes
from filtering.moments import group_moments
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from vapor.checkpoints.calibration import Calibration
from vapor.evaluation.trajectory import THRESHOLDS
from vapor.evaluation.validation import LOG_FLOOR


def posterior_metrics(
    posteriors: Iterable[Poses],
    truth: Poses,
    calibration: Calibration,
    *,
    gamma: float = 0.1,
    exact_log_density: Float64[np.ndarray, " n"] | None = None,
) -> dict[str, Any]:
    """Figures over the images of a test set.

    Args:
        posteriors: Posterior samples of each image, world_from_camera, (m,).
        truth: True poses, world_from_camera, (n,).
        calibration: Kernel widths of the density, and the radius of a place.
        gamma: Fraction of an image's samples that must be near its true pose for the posterior to count as right.
        exact_log_density: Log density of each image's own posterior at its true pose, per m³ rad³, where it is known.

    Returns:
        `images`; `recall`, `mode_recall` and `oracle_recall`, for each of `THRESHOLDS` the fraction of the images of
        which at least γ of the samples (Zangeneh et al., ICRA 2023), the best mode, or any one sample is within both
        limits; `mean` and `mode`, the median errors of the samples' mean (arithmetic in position, chordal L2 in
        rotation) and of the best mode, `translation_m` and `rotation_deg`; `negative_log_density`, the mean of
        −log(p̂ + 10⁻⁴ per m³ rad³) at the true pose, nats, so that no single image decides, p̂ being the kernel density
        of the samples; `exact_negative_log_density`, the same of the exact density, None where there is none; `modes`,
        the mean number of modes, the places among the samples.

    Raises:
        VaporTrackError: γ outside (0, 1], no image, or not as many posteriors as true poses.
    """
    if not 0.0 < gamma <= 1.0:
        raise VaporTrackError(f"gamma is {gamma}, expected it in (0, 1]")
    inside: list[list[np.ndarray]] = []
    errors, densities, counts = [], [], []
    for index, samples in enumerate(posteriors):
        if index >= len(truth):
            raise VaporTrackError(f"more posteriors than the {len(truth)} true poses, expected one for each")
        true_pose = truth[[index]]
        found = posterior_modes(PosePosterior.from_samples(samples, calibration.errors))
        equal, together = np.full(len(samples), 1.0 / len(samples)), np.zeros(len(samples), np.int64)
        mean, _, _ = group_moments(samples, equal, together, 1)
        points = Poses.concatenate([samples, mean, Poses.stack([found[0].world_from_camera])])
        translation_m, rotation_rad = points.distance(true_pose)
        rotation_deg = np.degrees(rotation_rad)
        near = np.stack([(translation_m <= m) & (rotation_deg <= deg) for m, deg in THRESHOLDS.values()])
        fraction = near[:, :-2].mean(axis=1)
        inside.append([fraction >= gamma - 1e-12, near[:, -1], fraction > 0])
        errors.append([translation_m[-2:], rotation_deg[-2:]])
        densities.append(np.logaddexp(calibration.density(samples).log_density(true_pose)[0], LOG_FLOOR))
        counts.append(len(found))
    if len(inside) != len(truth) or not inside:
        raise VaporTrackError(f"{len(inside)} posteriors for {len(truth)} true poses, expected one for each, and one")
    recall = np.mean(inside, axis=0)
    median = np.median(errors, axis=0)
    exact = None
    if exact_log_density is not None:
        exact = float(-np.mean(np.logaddexp(exact_log_density, LOG_FLOOR)))
    by_threshold = (dict(zip(THRESHOLDS, map(float, row), strict=True)) for row in recall)
    return {
        "images": len(inside),
        **dict(zip(("recall", "mode_recall", "oracle_recall"), by_threshold, strict=True)),
        **{
            name: {"translation_m": float(median[0, k]), "rotation_deg": float(median[1, k])}
            for k, name in enumerate(("mean", "mode"))
        },
        "negative_log_density": float(-np.mean(densities)),
        "exact_negative_log_density": exact,
        "modes": float(np.mean(counts)),
    }
