"""How wrong odometry is, from recordings that have true poses as well: white noise, drift and scale error."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from jaxtyping import Float64
from scipy.linalg import cho_factor, cho_solve, get_lapack_funcs
from scipy.optimize import minimize

from filtering.motion import Odometry, SlowErrors, accumulated, require_odometry
from filtering.se3 import Poses
from sequences.errors import SequenceError

LEAST_INCREMENTS = 100
_PIECE = 300  # increments whose errors are evaluated together: the work grows with its cube
_CLIP = 5.0  # robust standard deviations
_SMOOTHED_S = 1.0
_TIME_S = 30.0  # of the drift, where the data cannot tell
_SCALE = SlowErrors.scale
_DRIFT_SPREAD, _TIME_SPREAD = np.log(5.0), np.log(3.0)  # of the priors, in logarithms
_LEAST_CURVATURE = 0.02  # of the posterior, in the logarithm of a variance
_AT_REST = 20.0  # a camera at rest errs at least by this part of the variance that it has on average
_RANGE = (-14.0, 7.0)  # of logarithms of variances, about where the search begins

Six = tuple[float, float, float, float, float, float]


@dataclass(frozen=True)
class OdometrySegment:
    """Consecutive increments of odometry and the true poses that they lead from and to.

    Attributes:
        odometry: n increments of the camera.
        truth: world_from_camera, (n + 1,).
        recording: Number of the recording it is from: the scale error is one for all of it.
    """

    odometry: Sequence[Odometry]
    truth: Poses
    recording: int = 0


@dataclass(frozen=True)
class OdometryFit:
    """How wrong odometry was found to be, axis by axis of (v, ω) in the camera frame.

    Attributes:
        white_per_s: Variance of the white noise that comes in a second, m²/s and rad²/s.
        white_per_m: Variance that comes in a metre on top of it, m²/m and rad²/m; zeros where the data cannot tell.
        drift: Standard deviation of the drift, m/s and rad/s.
        time_s: Time over which it changes.
        scale: Scale error of the recordings on average: a distance reported too long is positive.
        scale_std: Standard deviation of a recording's scale error about zero. That of the defaults counts as one more
            recording.
        pose_noise: Standard deviation of the noise of single poses, of those taken for true or of those whose motion is
            reported, metres and radians.
        white_error: Standard error of √white_per_s, as a fraction of it.
        drift_error: Standard error of the drift, as a fraction of it.
        scale_error: Standard error of `scale`; 1 where nothing moved.
        increments: Number of increments.
        recordings: Number of recordings.
        seconds: Length of all of them.
        metres: Distance travelled in all.
        clipped: Number of errors of single axes that were cut to five robust standard deviations.
    """

    white_per_s: Six
    white_per_m: Six
    drift: Six
    time_s: float
    scale: float
    scale_std: float
    pose_noise: Six
    white_error: Six
    drift_error: Six
    scale_error: float
    increments: int
    recordings: int
    seconds: float
    metres: float
    clipped: int

    @property
    def slow_errors(self) -> SlowErrors:
        """What the filter takes of it beside the white noise."""
        return SlowErrors(scale=self.scale_std, drift=self.drift, time_s=self.time_s)

    def along(
        self, tangent: Float64[np.ndarray, "*batch 6"], duration_s: Float64[np.ndarray, "*batch"]
    ) -> Float64[np.ndarray, "*batch 6"]:
        """Variances of white noise, m² and rad², that come along motions of constant twist, as `MotionNoise.along`.

        Args:
            tangent: ξ = (v, ω) of each motion.
            duration_s: Seconds it took.
        """
        moved_m = np.linalg.norm(tangent[..., :3], axis=-1)
        return np.multiply.outer(duration_s, self.white_per_s) + np.multiply.outer(moved_m, self.white_per_m)

    def restated(self, odometry: Odometry) -> Odometry:
        """The same increment with the covariance of the white noise that was found."""
        tangent = odometry.previous_from_current.log()
        noise = np.diag(self.along(tangent, np.array(odometry.duration_s)))
        return replace(odometry, covariance=accumulated(tangent, noise))

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> OdometryFit:
        """What `dataclasses.asdict` and JSON made of one.

        Raises:
            SequenceError: a value is missing, one too many, or no number, or there are other than six for an axis each.
        """
        expected = {entry.name for entry in fields(cls)}
        if set(values) != expected:
            raise SequenceError(
                f"fit of odometry with {', '.join(sorted(set(values) ^ expected))} missing or one too many, expected"
                f" {', '.join(sorted(expected))}"
            )
        numbers: dict[str, Any] = {}
        for entry in fields(cls):
            value = np.asarray(values[entry.name])
            numeric = np.issubdtype(value.dtype, np.number) and np.isfinite(value).all()
            shape = (6,) if entry.type == "Six" else ()
            if value.shape != shape or not numeric or (entry.name != "scale" and (value < 0).any()):
                raise SequenceError(
                    f"fit of odometry: {entry.name} is {values[entry.name]!r}, expected"
                    f" {'six numbers' if shape else 'a number'}{'' if entry.name == 'scale' else ' of 0 or more'}"
                )
            numbers[entry.name] = _six(value) if shape else int(value) if entry.type == "int" else float(value)
        return cls(**numbers)

    def __str__(self) -> str:
        """A few lines for people: standard deviations, millimetres and degrees."""

        def row(values: Six, errors: Six | None = None) -> str:
            m, deg = np.array(values[:3]) * 1e3, np.degrees(values[3:])
            text = f"{' '.join(f'{v:.2g}' for v in m)} mm, {' '.join(f'{v:.2g}' for v in deg)}°"
            if errors is None:
                return text
            return text + f" (± {' '.join('?' if e > 9.99 else f'{100 * e:.0f}' for e in errors)} %)"

        per_m = f"\n  white after 1 m, on top: {row(_six(np.sqrt(self.white_per_m)))}" if any(self.white_per_m) else ""
        return (
            f"odometry, from {self.increments} increments ({self.seconds:.0f} s, {self.metres:.1f} m,"
            f" {self.recordings} recording{'s' if self.recordings > 1 else ''}; {self.clipped} errors cut):\n"
            f"  white after 1 s: {row(_six(np.sqrt(self.white_per_s)), self.white_error)}{per_m}\n"
            f"  drift in 1 s:    {row(self.drift, self.drift_error)}, changes over {self.time_s:.0f} s\n"
            f"  scale: {100 * self.scale:+.1f} ± {100 * self.scale_error:.1f} %, standard deviation taken:"
            f" {100 * self.scale_std:.1f} %\n"
            f"  noise of single poses: {row(self.pose_noise)}"
        )


def fit_odometry(segments: Sequence[OdometrySegment], *, max_increments: int = 1000) -> OdometryFit:
    """Fit white noise, drift and scale error by maximum likelihood.

    The error of increment i, true⁻¹ odometry, is on each axis s·vᵢ + bᵢ dtᵢ + wᵢ + mᵢ₋₁ − mᵢ: scale error s, drift b
    (an Ornstein-Uhlenbeck process), white noise w of variance q dtᵢ (+ p |vᵢ|, where that explains the errors better by
    the Bayesian information criterion), and noise m of single poses, which does not add up: without
    it true poses that jitter at a high rate would pass for white noise. What the data cannot tell
    follows weak priors: the drift errs over a second about as much as everything does, and changes over 30 s.

    s is fitted with the velocity averaged over a second as its instrument: the velocity itself shares the noise of the
    true poses with the errors.

    Args:
        segments: With 100 increments in all, at least.
        max_increments: Where there are more, neighbours are put together.

    Raises:
        SequenceError: too few increments, or true poses that are not as many as increments and one.
        VaporTrackError: odometry that is none.
    """
    pieces, increments = _pieces(segments, max_increments)
    limits = _limits([piece.errors / np.sqrt(piece.dt)[:, None] for piece in pieces])
    clipped = 0
    for piece in pieces:
        limit = limits * np.sqrt(piece.dt)[:, None]
        clipped += int((np.abs(piece.errors) > limit).sum())
        piece.errors = np.clip(piece.errors, -limit, limit)
    model = _Model(pieces)
    scales = _Scales(sorted({piece.recording for piece in pieces}))
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
        white_per_s=_six(q),
        white_per_m=_six(p),
        drift=_six(np.sqrt(b)),
        time_s=float(time_s),
        scale=scales.mean,
        scale_std=scales.std,
        pose_noise=_six(np.sqrt(r)),
        white_error=_six(errors[:6] / 2),  # of the logarithm of a variance, halved: of the standard deviation
        drift_error=_six(errors[6:12] / 2),
        scale_error=scales.error,
        increments=increments,
        recordings=len(scales.numbers),
        seconds=float(sum(piece.dt.sum() for piece in pieces)),
        metres=float(sum(piece.moved.sum() for piece in pieces)),
        clipped=clipped,
    )


def _six(values: np.ndarray) -> Six:
    """Six numbers of an array, (6,)."""
    a, b, c, d, e, f = (float(value) for value in values)
    return a, b, c, d, e, f


# --- the errors ------------------------------------------------------------------------------------


@dataclass
class _Piece:
    """Errors (n, 6) of consecutive increments, with what may explain them.

    Attributes:
        errors: Tangent vectors, in the camera frame after each increment, (n, 6).
        dt: Seconds, (n,).
        moved: Metres at the true speed averaged over a second, (n,). The length of the increment itself is the longer
            the more it errs.
        motion: True velocities times dt, (n, 3).
        smoothed: The same, averaged over a second.
    """

    recording: int
    errors: np.ndarray
    dt: np.ndarray
    moved: np.ndarray
    motion: np.ndarray
    smoothed: np.ndarray

    def __post_init__(self) -> None:
        n, time = len(self.dt), np.cumsum(self.dt) - self.dt / 2
        self.apart = np.abs(time[:, None] - time)
        self.product = np.outer(self.dt, self.dt)
        self.jitter = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)


def _pieces(segments: Sequence[OdometrySegment], max_increments: int) -> tuple[list[_Piece], int]:
    """Segments cut into pieces of at most 300 increments; and the number of increments given."""
    increments = 0
    for number, segment in enumerate(segments):
        if len(segment.truth) != len(segment.odometry) + 1:
            raise SequenceError(
                f"segment {number}: {len(segment.truth)} true poses of {len(segment.odometry)} increments, expected"
                " one more than increments"
            )
        increments += len(segment.odometry)
    if increments < LEAST_INCREMENTS:
        raise SequenceError(f"{increments} increments of odometry, expected at least {LEAST_INCREMENTS} to fit it")
    together = -(-increments // max_increments)
    pieces = []
    for segment in segments:
        merged, at = _merged(segment, together)
        if len(merged) < 3:
            continue
        real = segment.truth[at[:-1]].inverse() @ segment.truth[at[1:]]
        reported = Poses.stack([step.previous_from_current for step in merged])
        errors, motion = (real.inverse() @ reported).log(), real.log()[:, :3]
        dt = np.array([step.duration_s for step in merged])
        moved = _smoothed(np.linalg.norm(motion, axis=-1, keepdims=True), dt)[:, 0]
        smoothed = _smoothed(motion, dt)
        for part in np.array_split(np.arange(len(merged)), -(-len(merged) // _PIECE)):
            pieces.append(_Piece(segment.recording, errors[part], dt[part], moved[part], motion[part], smoothed[part]))
    if sum(len(piece.dt) for piece in pieces) < LEAST_INCREMENTS / 2:
        raise SequenceError("too few increments of odometry that follow each other and take time to fit it")
    return pieces, increments


def _merged(segment: OdometrySegment, together: int) -> tuple[list[Odometry], np.ndarray]:
    """Increments put together by so many, and more where they take no time; and the true poses between them."""
    merged, at, count = [], [0], 0
    current: Odometry | None = None
    for i, step in enumerate(segment.odometry):
        require_odometry(step)
        current, count = (step if current is None else current.then(step)), count + 1
        if count >= together and current.duration_s > 0:
            merged.append(current)
            at.append(i + 1)
            current, count = None, 0
    return merged, np.array(at)


def _smoothed(motion: np.ndarray, dt: np.ndarray) -> np.ndarray:
    """Motions (n, k) with the velocity averaged over a second about each, one neighbour on either side at least."""
    half = max(1, round(_SMOOTHED_S / 2 / float(np.median(dt))))
    total = np.concatenate([np.zeros((1, motion.shape[1])), np.cumsum(motion, axis=0)])
    time = np.concatenate([[0.0], np.cumsum(dt)])
    index = np.arange(len(dt))
    first, last = np.maximum(index - half, 0), np.minimum(index + half + 1, len(dt))
    return (total[last] - total[first]) / (time[last] - time[first])[:, None] * dt[:, None]


def _limits(rates: Sequence[np.ndarray]) -> np.ndarray:
    """Five robust standard deviations of each axis (6,) of errors (n, 6), or infinity where most have none."""
    typical = np.median(np.abs(np.concatenate(rates)), axis=0) / 0.6745
    return np.where(typical > 0, _CLIP * typical, np.inf)


# --- the model -------------------------------------------------------------------------------------


class _Scales:
    """Scale errors of recordings, given the rest."""

    def __init__(self, numbers: Sequence[int]) -> None:
        self.numbers = list(numbers)
        self.values = dict.fromkeys(self.numbers, 0.0)
        self.mean, self.error, self.std = 0.0, 1.0, _SCALE

    def fit(self, pieces: Sequence[_Piece], model: _Model, parameters: np.ndarray) -> None:
        """Estimate each by its instrument, then shrink it by what all of them and the default say of its spread."""
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


class _Model:
    """Likelihood of the errors. Parameters are logarithms: q, b², r² (6 each), time, and p (6) or none."""

    def __init__(self, pieces: Sequence[_Piece]) -> None:
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

    def covariance(self, piece: _Piece, axis: int, parameters: np.ndarray) -> np.ndarray:
        """Covariance (n, n) of the errors of a piece on one axis, but for that of the scale."""
        q, b, r, time_s, p = self.unpack(parameters)
        covariance = b[axis] * piece.product * np.exp(-piece.apart / time_s) + r[axis] * piece.jitter
        covariance[np.diag_indices(len(piece.dt))] += q[axis] * piece.dt + p[axis] * piece.moved
        return covariance

    def loss(self, parameters: np.ndarray, scales: _Scales) -> tuple[float, np.ndarray]:
        """Negative log posterior, up to a constant, and its gradient."""
        return self._posterior(parameters, self._likelihood(parameters, scales, range(6)))

    def _likelihood(self, parameters: np.ndarray, scales: _Scales, axes: Iterable[int]) -> np.ndarray:
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
        """The loss and its gradient, from the likelihood of all axes and what is assumed of the drift."""
        _, q, b, r, _, p = terms.sum(axis=0).T
        loss, _, _, _, time, _ = terms.reshape(-1, 6).sum(axis=0)
        gradient = np.concatenate([q, b, r, [time], p])
        spread = 2 * _DRIFT_SPREAD  # of the variance
        off = (parameters[6:12] - self._drift_centre) / spread
        late = (parameters[18] - np.log(_TIME_S)) / _TIME_SPREAD
        gradient[6:12] += off / spread
        gradient[18] += late / _TIME_SPREAD
        return float(loss) + 0.5 * float(off @ off) + 0.5 * float(late**2), gradient[: len(parameters)]

    def search(self, start: np.ndarray, scales: _Scales, least_log_q: np.ndarray | None = None) -> np.ndarray:
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

    def standard_errors(self, parameters: np.ndarray, scales: _Scales) -> np.ndarray:
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


def _within_a_second(pieces: Sequence[_Piece]) -> np.ndarray:
    """Mean square of the errors (6,) that add up over a second, m² and rad²."""
    sums = []
    for piece in pieces:
        second = (np.cumsum(piece.dt) - piece.dt).astype(np.int64)
        sums.append(np.stack([np.bincount(second, piece.errors[:, axis]) for axis in range(6)], axis=1))
    return np.mean(np.square(np.concatenate(sums)), axis=0)
