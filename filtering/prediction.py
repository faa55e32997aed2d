"""Prediction: odometry moves hypotheses; without any they are inflated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from filtering.hypotheses import BIAS, POSE, Hypotheses, blocks
from filtering.moments import settle
from filtering.motion import Odometry, OdometryBias
from filtering.se3 import Poses

_WIDEST_RAD = 2.0  # standard deviation: all directions
_LONGEST_S = 1e10  # three centuries


def motion_of_state(
    odometry: Odometry, odometry_bias: OdometryBias, distances: Sequence[float]
) -> tuple[Float64[np.ndarray, "d d"], Float64[np.ndarray, "d d"]]:
    """The linear transition of a state by a motion, and the covariance of the noise that the motion adds.

    The pose moves by the increment; the transition gives its error relative to that.

    Args:
        odometry: The motion.
        odometry_bias: Its bias.
        distances: Normalized distance that the camera of each source moved.
    """
    size = 13 + 6 * len(distances)
    duration_s = min(odometry.duration_s, _LONGEST_S)
    errs = np.zeros(
        (6, 7)
    )  # of the increment, by scale error and drift; a positive scale error means too long increments
    errs[:3, 0] = -odometry.tangent[:3]
    if odometry_bias.drift is None:
        drift = odometry_bias.relative_drift * np.sqrt(np.diag(odometry.covariance) * duration_s)
    else:
        drift = np.asarray(odometry_bias.drift) * duration_s
    errs[:, 1:] = -np.diag(drift)
    kept = np.ones(size - 6)
    kept[1:7] = np.exp(-duration_s / odometry_bias.time_s)
    for source, distance in enumerate(distances):
        kept[7 + 6 * source : 13 + 6 * source] = np.exp(-distance)
    transition = np.zeros((size, size))
    transition[POSE, POSE] = odometry.carry
    transition[POSE, BIAS] = errs
    rest = np.arange(6, size)
    transition[rest, rest] = kept
    noise = np.zeros((size, size))
    noise[POSE, POSE] = odometry.noise
    noise[rest, rest] = 1.0 - kept**2
    return transition, noise


def predict(
    hypotheses: Hypotheses, odometry: Odometry, odometry_bias: OdometryBias, distances: Sequence[float]
) -> Hypotheses:
    """Hypotheses after a motion.

    Args:
        hypotheses: Before.
        odometry: The motion.
        odometry_bias: Its bias.
        distances: Normalized distance that the camera of each source moved.
    """
    transition, noise = motion_of_state(odometry, odometry_bias, distances)
    step = odometry.previous_from_current
    kept = np.diag(transition)[6:]
    poses = hypotheses.poses @ (step @ Poses.exp(hypotheses.mean[:, :7] @ transition[POSE, BIAS].T))
    covariance = _carried(hypotheses.covariance, transition[POSE, :13], kept)
    covariance[:, POSE, POSE] += noise[POSE, POSE]
    rest = np.arange(6, len(noise))
    covariance[:, rest, rest] += np.diag(noise)[6:]
    return Hypotheses(poses.orthonormal(), hypotheses.mean * kept, covariance, hypotheses.log_weights)


def inflate(hypotheses: Hypotheses, covariance: Float64[np.ndarray, "6 6"]) -> Hypotheses:
    """Hypotheses after a motion of which only the covariance of ξ = (v, ω) is known; all directions may be open."""
    grown = hypotheses.covariance.copy()
    grown[:, POSE, POSE] += covariance
    turned = np.arange(3, 6)
    scale = np.ones(grown.shape[:2])
    scale[:, turned] = np.minimum(1.0, _WIDEST_RAD / np.sqrt(grown[:, turned, turned]))
    grown *= scale[:, :, None] * scale[:, None, :]
    return replace(hypotheses, covariance=grown)


def _carried(
    covariance: Float64[np.ndarray, "n d d"], pose: Float64[np.ndarray, "6 13"], kept: Float64[np.ndarray, " m"]
) -> Float64[np.ndarray, "n d d"]:
    """F C Fᵀ for a transition F with full rows for the pose, and a diagonal otherwise."""
    size = covariance.shape[1]
    scale = np.concatenate([np.ones(6), kept])
    scales = np.multiply.outer(scale, scale)
    carried = np.empty_like(covariance)
    for block in blocks(len(covariance)):
        before, after = covariance[block], carried[block]
        half = (before.reshape(-1, size)[:, :13] @ pose.T).reshape(-1, size, 6)
        np.multiply(before, scales, out=after)
        after[:, POSE, POSE] = pose @ half[:, :13]
        after[:, 6:, POSE] = across = half[:, 6:] * kept[:, None]
        after[:, POSE, 6:] = np.swapaxes(across, 1, 2)
        settle(after[:, POSE, POSE])
    return carried
