"""A measurement of the state and the Kalman update that it gives, for many hypotheses at once.

A measurement is an innovation, a Jacobian and a noise, whether of a place in an image or of anything else.
Source: Solà, Deray and Atchuthan, "A micro Lie theory for state estimation in robotics", 2018 (error states on SE(3)).
"""

from __future__ import annotations

from functools import reduce
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64

from filtering.hypotheses import blocks
from filtering.moments import settle

Jacobian = tuple[tuple[slice, Float64[np.ndarray, "p k s"] | None], ...]
"""Blocks of a Jacobian: a part of the state, and the matrix that leads from it; None for the identity."""


class Measurement(NamedTuple):
    """p measurements y = J x + noise, each of the state x of one hypothesis.

    Attributes:
        innovation: The measured value less the expected one, (p, k).
        jacobian: Of the measured value with respect to the state.
        noise: Covariance of the noise, (p, k, k).
    """

    innovation: Float64[np.ndarray, "p k"]
    jacobian: Jacobian
    noise: Float64[np.ndarray, "p k k"]


class PredictedMeasurement(NamedTuple):
    """Measurements as their p hypotheses predict them.

    Attributes:
        cross_covariance: Of state and innovation, P Jᵀ, (p, d, k).
        innovation_precision: Inverse covariance S⁻¹ of the innovation, (p, k, k).
    """

    cross_covariance: Float64[np.ndarray, "p d k"]
    innovation_precision: Float64[np.ndarray, "p k k"]


def predict_measurement(
    covariance: Float64[np.ndarray, "n d d"], hypothesis: Int64[np.ndarray, " p"], jacobian: Jacobian, noise: np.ndarray
) -> PredictedMeasurement:
    """Predict measurements.

    Args:
        covariance: Of the states of n hypotheses.
        hypothesis: Index of the hypothesis of each measurement.
        jacobian: Of the measurements.
        noise: Their covariance, (p, k, k).
    """
    cross = reduce(np.add, [_times(covariance[:, :, part][hypothesis], matrix) for part, matrix in jacobian])
    of_state = reduce(
        np.add, [cross[:, part] if matrix is None else matrix @ cross[:, part] for part, matrix in jacobian]
    )
    return PredictedMeasurement(cross, np.linalg.inv(of_state + noise))


def kalman_update(
    covariance: Float64[np.ndarray, "n d d"],
    hypothesis: Int64[np.ndarray, " p"],
    measurement: Measurement,
    predicted: PredictedMeasurement,
) -> tuple[Float64[np.ndarray, "p d"], Float64[np.ndarray, "p d d"]]:
    """The change of the state that each measurement makes, and the covariance after it, in Joseph's form.

    P − K Jᵀ loses all digits of a measurement that is some 10⁷ times more precise than the belief. (I − K J) P
    (I − K J)ᵀ + K R Kᵀ does not; that is U − (U Jᵀ − K R) Kᵀ with U = P − K (P Jᵀ)ᵀ, where the product in brackets
    is the rounding error in U.

    Args:
        covariance: Of the states of n hypotheses.
        hypothesis: Index of the hypothesis of each of p measurements.
        measurement: The measurements.
        predicted: From `predict_measurement`.
    """
    cross = predicted.cross_covariance
    gain = cross @ predicted.innovation_precision
    change = (gain @ measurement.innovation[:, :, None])[:, :, 0]
    after = np.empty((len(hypothesis), *covariance.shape[1:]))
    for block in blocks(len(hypothesis)):
        before, transposed = covariance[hypothesis[block]], np.swapaxes(gain[block], 1, 2)
        plain = before - gain[block] @ np.swapaxes(cross[block], 1, 2)
        parts = [
            _times(plain[:, :, part], None if matrix is None else matrix[block])
            for part, matrix in measurement.jacobian
        ]
        left = reduce(np.add, parts) - gain[block] @ measurement.noise[block]
        np.subtract(plain, left @ transposed, out=after[block])
        settle(after[block], np.einsum("nii->ni", before))
    return change, after


def _times(columns: Float64[np.ndarray, "p d s"], matrix: Float64[np.ndarray, "p k s"] | None) -> np.ndarray:
    return columns if matrix is None else columns @ np.swapaxes(matrix, 1, 2)
