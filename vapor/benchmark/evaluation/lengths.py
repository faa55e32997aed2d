"""Poses, beliefs and settings in another unit of length: a room as large as a car park, or as small as a shoebox."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from filtering.config import LocalizerConfig
from filtering.estimate import Mode
from filtering.motion import Odometry
from filtering.se3 import Poses
from sequences.odometry_fit.result import OdometryFit
from vapor.checkpoints.calibration import Calibration
from vapor.tracking.loop import Belief


def scaled_poses(poses: Poses, factor: float) -> Poses:
    """Poses (any batch) whose positions are multiplied by a factor."""
    return Poses(poses.rotation, factor * poses.translation)


def scaled_odometry(odometry: Odometry, factor: float) -> Odometry:
    """A motion whose lengths are multiplied by a factor, in the same time."""
    motion = scaled_poses(odometry.previous_from_current, factor)
    return replace(odometry, previous_from_current=motion, covariance=odometry.covariance * _products(factor))


def scaled_mode(mode: Mode, factor: float) -> Mode:
    """A mode whose lengths are multiplied by a factor."""
    pose = scaled_poses(mode.world_from_camera, factor)
    return replace(mode, world_from_camera=pose, covariance=mode.covariance * _products(factor))


def scaled_belief(belief: Belief, factor: float) -> Belief:
    """A belief whose lengths are multiplied by a factor."""
    return replace(belief, modes=[tuple(scaled_mode(mode, factor) for mode in modes) for modes in belief.modes])


def scaled_calibration(calibration: Calibration, factor: float) -> Calibration:
    """How a model errs whose map's lengths are multiplied by a factor, and the odometry of its scene."""
    fit = calibration.odometry
    return replace(
        calibration,
        bandwidth_translation_m=factor * calibration.bandwidth_translation_m,
        errors=calibration.errors.scaled(factor),
        odometry=None if fit is None else _scaled_fit(fit, factor),
    )


def scaled_localizer(config: LocalizerConfig, factor: float) -> LocalizerConfig:
    """Settings of the filter whose lengths, where they are stated, are multiplied by a factor."""
    widest_m, gap = config.converged_std_m, config.gap
    return replace(
        config,
        converged_std_m=None if widest_m is None else factor * widest_m,
        gap=replace(gap, speed_m_per_s=factor * gap.speed_m_per_s),
    )


def _scaled_fit(fit: OdometryFit, factor: float) -> OdometryFit:
    lengths = np.sqrt(np.diag(_products(factor)))

    def times(values: tuple[float, ...], factors: Float64[np.ndarray, " 6"]) -> tuple[float, ...]:
        return tuple((np.array(values) * factors).tolist())

    return replace(
        fit,
        white_per_s=times(fit.white_per_s, lengths**2),
        white_per_m=times(fit.white_per_m, lengths**2 / factor),
        drift=times(fit.drift, lengths),
        pose_noise=times(fit.pose_noise, lengths),
        metres=factor * fit.metres,
    )


def _products(factor: float) -> Float64[np.ndarray, "6 6"]:
    """Factors by which a covariance of (v, ω) is multiplied when lengths are multiplied by a factor."""
    lengths = np.array([factor] * 3 + [1.0] * 3)
    return np.outer(lengths, lengths)
