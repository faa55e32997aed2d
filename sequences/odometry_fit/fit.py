"""White noise, drift and scale error of odometry, fitted by maximum likelihood."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from threadpoolctl import threadpool_limits

from sequences.odometry_fit.likelihood import Likelihood, ScaleErrors
from sequences.odometry_fit.pieces import OdometrySegment, cut_into_pieces, error_limits
from sequences.odometry_fit.result import OdometryFit, six

_AT_REST = 20.0  # a camera at rest errs at least by this part of the variance that it has on average


def fit_odometry(segments: Sequence[OdometrySegment], *, max_increments: int = 1000) -> OdometryFit:
    """Fit white noise, drift and scale error by maximum likelihood.

    The error of increment i, true⁻¹ odometry, is on each axis s·vᵢ + bᵢ dtᵢ + wᵢ + mᵢ₋₁ − mᵢ: scale error s, drift b
    (an Ornstein-Uhlenbeck process), white noise w of variance q dtᵢ (+ p |vᵢ|, where that explains the errors better by
    the Bayesian information criterion), and noise m of single poses, which does not add up: without it, true poses that
    jitter at a high rate would pass for white noise. What the data cannot tell follows weak priors: the drift errs over
    a second about as much as everything does, and changes over 30 s.

    s is fitted with the velocity averaged over a second as its instrument: the velocity itself shares the noise of the
    true poses with the errors.

    Args:
        segments: With 100 increments in all, at least.
        max_increments: Where there are more, neighbours are put together.

    Raises:
        SequenceError: too few increments, or true poses that are not as many as increments and one.
        VaporTrackError: odometry that is none.
    """
    # On a busy processor threads that wait for each other made this a hundred times slower.
    with threadpool_limits(1, user_api="blas"):
        return _fit(segments, max_increments)


def _fit(segments: Sequence[OdometrySegment], max_increments: int) -> OdometryFit:
    pieces, increments = cut_into_pieces(segments, max_increments)
    limits = error_limits([piece.errors / np.sqrt(piece.dt)[:, None] for piece in pieces])
    clipped = 0
    for piece in pieces:
        limit = limits * np.sqrt(piece.dt)[:, None]
        clipped += int((np.abs(piece.errors) > limit).sum())
        piece.errors = np.clip(piece.errors, -limit, limit)
    model = Likelihood(pieces)
    scales = ScaleErrors(sorted({piece.recording for piece in pieces}))
    parameters = model.search(model.start, scales)
    for _ in range(2):
        scales.fit(pieces, model, parameters)
        parameters = model.search(parameters, scales)
    more = model.search(model.with_distance(parameters), scales, least_log_q=parameters[:6] - np.log(_AT_REST))
    gain = model.loss(parameters, scales)[0] - model.loss(more, scales)[0]
    if gain > 0.5 * 6 * np.log(sum(len(piece.dt) for piece in pieces)):
        parameters = more
    scales.fit(pieces, model, parameters)
    errors = model.standard_errors(parameters, scales)
    q, b, r, time_s, p = model.unpack(parameters)
    return OdometryFit(
        white_per_s=six(q),
        white_per_m=six(p),
        drift=six(np.sqrt(b)),
        time_s=float(time_s),
        scale=scales.mean,
        scale_std=scales.std,
        pose_noise=six(np.sqrt(r)),
        white_error=six(errors[:6] / 2),  # of the logarithm of a variance, halved: of the standard deviation
        drift_error=six(errors[6:12] / 2),
        scale_error=scales.error,
        increments=increments,
        recordings=len(scales.numbers),
        seconds=float(sum(piece.dt.sum() for piece in pieces)),
        metres=float(sum(piece.moved.sum() for piece in pieces)),
        clipped=clipped,
    )
