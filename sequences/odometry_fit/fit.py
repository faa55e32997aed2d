"""White noise, drift and scale error of odometry, fitted by maximum likelihood."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from scipy.linalg import cho_factor, cho_solve, get_lapack_funcs
from scipy.optimize import minimize
from threadpoolctl import threadpool_limits

from filtering.motion import OdometryBias
from sequences.odometry_fit.pieces import OdometrySegment, Piece, cut_into_pieces, error_limits
from sequences.odometry_fit.result import OdometryFit, six

_TIME_S = 30.0  # of the drift, where the data do not determine it
_SCALE = OdometryBias.scale
_DRIFT_SPREAD, _TIME_SPREAD = np.log(5.0), np.log(3.0)  # of the priors, in logarithms
_LEAST_CURVATURE = 0.02  # of the posterior, in the logarithm of a variance
_RANGE = (-14.0, 7.0)  # of logarithms of variances, about where the search begins


class ScaleErrors:
    """Scale errors of recordings, given the rest."""

    def __init__(self, numbers: Sequence[int]) -> None:
        self.numbers = list(numbers)
        self.values = dict.fromkeys(self.numbers, 0.0)
        self.mean, self.error, self.std = 0.0, 1.0, _SCALE

    def fit(self, pieces: Sequence[Piece], model: Likelihood, parameters: np.ndarray) -> None:
        """Estimate each by its instrument, then shrink it by the spread of all of them and the default."""
        gain, crossed, weight = (dict.fromkeys(self.numbers, 0.0) for _ in range(3))
        for piece in pieces:
            for axis in range(3):
                factor = cho_factor(model.covariance(piece, axis, parameters), lower=True)
                solved = cho_solve(factor, piece.smoothed[:, axis])
                gain[piece.recording] += solved @ piece.errors[:, axis]
                crossed[piece.recording] += solved @ piece.motion[:, axis]
                weight[piece.recording] += solved @ piece.smoothed[:, axis]
        informed = [n for n in self.numbers if crossed[n] > 0]
        known = {n: (gain[n] / crossed[n], weight[n] / crossed[n] ** 2) for n in informed}
        variance, posterior = _SCALE**2, {}
        for _ in range(50):
            posterior = {
                n: (s * variance / (variance + e), variance * e / (variance + e)) for n, (s, e) in known.items()
            }
            variance = (_SCALE**2 + sum(s**2 + e for s, e in posterior.values())) / (1 + len(posterior))
        self.std = float(np.sqrt(variance))
        self.values = {n: float(posterior[n][0]) if n in posterior else 0.0 for n in self.numbers}
        information = sum(1 / e for _, e in known.values())
        self.mean = float(sum(s / e for s, e in known.values()) / information) if known else 0.0
        self.error = min(float(1 / np.sqrt(information)), 1.0) if known else 1.0


class Likelihood:
    """Likelihood of the errors. Parameters are logarithms: q, b², r² (6 each), time, and p (6) or none."""

    def __init__(self, pieces: Sequence[Piece]) -> None:
        self.pieces = pieces
        errors = np.concatenate([piece.errors for piece in pieces])
        dt = np.concatenate([piece.dt for piece in pieces])
        tiny = np.array([1e-12] * 6)
        rate = np.maximum(np.mean(errors**2, axis=0) / dt.mean(), tiny)
        within = np.maximum(_within_a_second(pieces), tiny)
        self._drift_centre = np.log(within / 4)  # half its deviation
        noise = 0.05 * dt.mean() * rate
        self.start = np.concatenate(
            [np.log(np.minimum(rate, 2 * within) / 2), self._drift_centre, np.log(noise), [np.log(_TIME_S)]]
        )
        self._speed = max(float(sum(piece.moved.sum() for piece in pieces) / dt.sum()), 1e-6)

    def with_distance(self, parameters: np.ndarray) -> np.ndarray:
        """Parameters to search from for white noise that grows with distance, too."""
        return np.concatenate(
            [parameters + np.log(0.5) * (np.arange(19) < 6), parameters[:6] + np.log(0.5 / self._speed)]
        )

    def unpack(self, parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, float, np.ndarray]:
        """q, b², r² of each axis, the time of the drift, p of each axis."""
        values = np.exp(parameters)
        p = values[19:] if len(values) > 19 else np.zeros(6)
        return values[:6], values[6:12], values[12:18], float(values[18]), p

    def covariance(self, piece: Piece, axis: int, parameters: np.ndarray) -> np.ndarray:
        """Covariance (n, n) of the errors of a piece on one axis, but for that of the scale."""
        q, b, r, time_s, p = self.unpack(parameters)
        covariance = b[axis] * piece.product * np.exp(-piece.apart / time_s) + r[axis] * piece.jitter
        covariance[np.diag_indices(len(piece.dt))] += q[axis] * piece.dt + p[axis] * piece.moved
        return covariance

    def loss(self, parameters: np.ndarray, scales: ScaleErrors) -> tuple[float, np.ndarray]:
        """Negative log posterior, up to a constant, and its gradient."""
        return self._posterior(parameters, self._likelihood(parameters, scales, range(6)))

    def _likelihood(self, parameters: np.ndarray, scales: ScaleErrors, axes: Iterable[int]) -> np.ndarray:
        """Of every piece and some axes (pieces, axes, 6): the loss, and its slopes along q, b², r², time and p."""
        q, b, r, time_s, p = self.unpack(parameters)
        axes = list(axes)
        terms = np.empty((len(self.pieces), len(axes), 6))
        factorize, invert = get_lapack_funcs(("potrf", "potri"), dtype=np.float64)
        for number, piece in enumerate(self.pieces):
            correlation = piece.product * np.exp(-piece.apart / time_s)
            slope = correlation * piece.apart / time_s
            for place, axis in enumerate(axes):
                covariance = b[axis] * correlation + r[axis] * piece.jitter
                diagonal = np.einsum("ii->i", covariance)
                diagonal += q[axis] * piece.dt + p[axis] * piece.moved
                factor, failed = factorize(covariance.T, lower=1, overwrite_a=1)  # by columns: it is not copied
                if failed:
                    raise np.linalg.LinAlgError(f"the covariance of axis {axis} has no Cholesky factor")
                logarithm = float(np.log(np.diag(factor)).sum())
                errors = piece.errors[:, axis]
                if axis < 3:
                    errors = errors - scales.values[piece.recording] * piece.motion[:, axis]
                inverse = invert(factor, lower=1, overwrite_c=1)[0].T  # its upper triangle, zeros below
                straight = np.diag(inverse)
                solved = inverse @ errors + errors @ inverse - straight * errors
                own = 0.5 * (straight - solved**2)
                terms[number, place] = (
                    0.5 * float(errors @ solved) + logarithm,
                    q[axis] * float(own @ piece.dt),
                    b[axis] * _slope(inverse, solved, correlation),
                    r[axis] * _slope(inverse, solved, piece.jitter),
                    b[axis] * _slope(inverse, solved, slope),
                    p[axis] * float(own @ piece.moved),
                )
        return terms

    def _posterior(self, parameters: np.ndarray, terms: np.ndarray) -> tuple[float, np.ndarray]:
        """The loss and its gradient, from the likelihood of all axes and the priors of the drift."""
        _, q, b, r, _, p = terms.sum(axis=0).T
        loss, _, _, _, time, _ = terms.reshape(-1, 6).sum(axis=0)
        gradient = np.concatenate([q, b, r, [time], p])
        spread = 2 * _DRIFT_SPREAD  # of the variance
        off = (parameters[6:12] - self._drift_centre) / spread
        late = (parameters[18] - np.log(_TIME_S)) / _TIME_SPREAD
        gradient[6:12] += off / spread
        gradient[18] += late / _TIME_SPREAD
        return float(loss) + 0.5 * float(off @ off) + 0.5 * float(late**2), gradient[: len(parameters)]

    def search(self, start: np.ndarray, scales: ScaleErrors, least_log_q: np.ndarray | None = None) -> np.ndarray:
        """The likeliest parameters."""
        reference = np.concatenate([self.start, self.start[:6] - np.log(self._speed)])[: len(start)]
        low, high = reference + _RANGE[0], reference + _RANGE[1]
        if least_log_q is not None:
            low[:6] = np.maximum(low[:6], least_log_q)
        found = minimize(
            self.loss,
            np.clip(start, low, high),
            (scales,),
            "L-BFGS-B",
            jac=True,
            bounds=list(zip(low, high, strict=True)),
            options={"maxiter": 100, "ftol": 1e-7},
        )
        return found.x

    def standard_errors(self, parameters: np.ndarray, scales: ScaleErrors) -> np.ndarray:
        """Of the logarithms, by the curvature of the posterior; about 7 where it is flat."""
        step, rows = 1e-3, []
        unchanged = self._likelihood(parameters, scales, range(6))
        for i in range(len(parameters)):
            axes = range(6) if i == 18 else [(i if i < 18 else i - 19) % 6]  # all but the time are of one axis each
            slopes = []
            for sign in (1, -1):
                changed, terms = parameters + sign * step * (np.arange(len(parameters)) == i), unchanged.copy()
                terms[:, list(axes)] = self._likelihood(changed, scales, axes)
                slopes.append(self._posterior(changed, terms)[1])
            rows.append((slopes[0] - slopes[1]) / (2 * step))
        values, vectors = np.linalg.eigh((np.array(rows) + np.array(rows).T) / 2)
        return np.sqrt(np.square(vectors) @ (1 / np.maximum(values, _LEAST_CURVATURE)))


def _slope(triangle: np.ndarray, solved: np.ndarray, part: np.ndarray) -> float:
    """Of a Gaussian's loss, as its covariance grows by a symmetric part.

    Takes a triangle of the inverse covariance with zeros beyond, and the inverse times the errors.
    """
    trace = 2 * np.vdot(triangle, part) - np.diag(triangle) @ np.diag(part)
    return 0.5 * float(trace - solved @ part @ solved)


def _within_a_second(pieces: Sequence[Piece]) -> np.ndarray:
    """Mean square of the errors (6,) that add up over a second, m² and rad²."""
    sums = []
    for piece in pieces:
        second = (np.cumsum(piece.dt) - piece.dt).astype(np.int64)
        sums.append(np.stack([np.bincount(second, piece.errors[:, axis]) for axis in range(6)], axis=1))
    return np.mean(np.square(np.concatenate(sums)), axis=0)


_AT_REST = 20.0  # a camera at rest errs at least by this part of the variance that it has on average


def fit_odometry(segments: Sequence[OdometrySegment], *, max_increments: int = 1000) -> OdometryFit:
    """Fit white noise, drift and scale error by maximum likelihood.

    The error of increment i, true⁻¹ odometry, is on each axis s·vᵢ + bᵢ dtᵢ + wᵢ + mᵢ₋₁ − mᵢ: scale error s, drift b
    (an Ornstein-Uhlenbeck process), white noise w of variance q dtᵢ (+ p |vᵢ|, where that explains the errors better by
    the Bayesian information criterion), and noise m of single poses, which does not add up: without it, true poses that
    jitter at a high rate would pass for white noise. Weak priors decide where the data do not: the drift errs over
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
