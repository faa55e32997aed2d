"""Prediction: odometry moves hypotheses; without any they move by an unknown velocity."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from filtering.config import GapConfig
from filtering.hypotheses import (
    BIAS,
    BIASED,
    DRIFT,
    POSE,
    RIGHT,
    USELESS,
    Hypotheses,
    blocks,
    concatenate,
    odometry_bias_of,
    set_drift,
)
from filtering.measurement_noise import MeasurementNoise
from filtering.moments import settle
from filtering.motion import GapMotion, Odometry, OdometryBias
from filtering.se3 import Poses
from filtering.unchecked import unchecked_replace

_WIDEST_RAD = 2.0  # standard deviation: all directions
_LONGEST_S = 1e10  # three centuries
_HEAVY = 0.01  # of a belief: hypotheses for which the regime of odometry may change
_MOST = 0.5  # of a hypothesis begins to fail in one motion
_LEAP, _USUAL_S = 10.0, 5.0  # times the usual speed that no camera has; seconds that this is the average of
_FASTEST = 1e6  # metres a second
_VIEWS_PER_S = 2.0  # standard deviation of the speed along each axis where odometry is useless, in new views
_SLIP_PER_S = 0.15  # new views: biased odometry errs by so many
_FARTHEST = 1e6  # standard deviations of the drift
_AXES, _DRIFTS = np.arange(6), np.arange(DRIFT.start, DRIFT.stop)


class StateMotion(NamedTuple):
    """What a motion does to a state of size d, linearly: x' = F x + w.

    Attributes:
        pose: The rows of F for the error of the pose, which pose and odometry bias lead to; the others are 0, (6, 13).
        kept: The diagonal of F for the rest of the state; its rows have nothing else, (d − 6,).
        noise: Covariance of w, (d, d).
    """

    pose: Float64[np.ndarray, "6 13"]
    kept: Float64[np.ndarray, " m"]
    noise: Float64[np.ndarray, "d d"]

    @property
    def transition(self) -> Float64[np.ndarray, "d d"]:
        """F as one matrix."""
        transition = np.diag(np.concatenate([np.zeros(6), self.kept]))
        transition[POSE, :13] = self.pose
        return transition


def motion_of_state(odometry: Odometry, odometry_bias: OdometryBias, distances: Sequence[float]) -> StateMotion:
    """The motion of a state.

    The pose moves by the increment; the transition gives its error relative to that.

    Args:
        odometry: The motion.
        odometry_bias: Its bias.
        distances: Normalized distance that the camera of each source moved.
    """
    duration_s = min(odometry.duration_s, _LONGEST_S)
    times = duration_s / odometry_bias.time_s
    lasting, drift = _lasting(times), drift_of(odometry, odometry_bias)
    fades = [duration_s / odometry_bias.scale_time_s, times, *distances]
    kept = np.exp(np.negative(fades)).repeat([1] + [6] * (len(fades) - 1))
    changes = 1.0 - kept**2
    changes[0] *= odometry_bias.scale**2
    noise = np.diag(np.concatenate([drift**2 * _integrated(times), changes]))
    noise[POSE, POSE] += odometry.noise
    # The drift changes during the motion: integrals of an Ornstein-Uhlenbeck process.
    noise[_AXES, _DRIFTS] = noise[_DRIFTS, _AXES] = -drift * lasting**2 * times
    return StateMotion(np.concatenate([odometry.carry, _errors_of(odometry, odometry_bias)], axis=1), kept, noise)


def _lasting(times: float) -> float:
    """How much of a drift is left on average during a motion, by its duration over the time in which drift changes."""
    return float(-np.expm1(-times) / times) if times > 1e-300 else 1.0


def _errors_of(odometry: Odometry, odometry_bias: OdometryBias) -> Float64[np.ndarray, "6 7"]:
    """What scale error and drift take from an increment; a positive scale error means too long ones."""
    duration_s = min(odometry.duration_s, _LONGEST_S)
    errs = np.zeros((6, 7))
    errs[:3, 0] = -odometry.tangent[:3]
    errs[_AXES, _AXES + 1] = -_lasting(duration_s / odometry_bias.time_s) * drift_of(odometry, odometry_bias)
    return errs


def _integrated(times: float) -> float:
    """Variance that a drift of variance 1 adds to its integral by changing, over the squared duration.

    Args:
        times: The duration over the time in which it changes.
    """
    if times < 1e-3:  # the closed form cancels
        return 2.0 / 3.0 * times
    keeps = np.exp(-times)
    return float((2.0 * times - 3.0 + 4.0 * keeps - keeps**2) / times**2)


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
    motion, increment = motion_of_state(odometry, odometry_bias, distances), odometry.previous_from_current
    poses = hypotheses.poses @ (increment @ Poses.exp(hypotheses.mean[:, :7] @ motion.pose[:, BIAS].T))
    mean, covariance = hypotheses.mean * motion.kept, _moved_covariance(hypotheses.covariance, motion)
    return unchecked_replace(hypotheses, poses=poses.orthonormal(), mean=mean, covariance=covariance)


def with_regimes(
    hypotheses: Hypotheses,
    odometry: Odometry,
    odometry_bias: OdometryBias,
    noise: MeasurementNoise,
    since_s: float,
    failures_per_s: float,
    failure_s: float,
) -> Hypotheses:
    """The same, and of each a small part for which odometry begins to fail now, or ceases to: a jump Markov model.

    Odometry that fails is biased or useless, equally often. Biased odometry has a drift as large as what it reports,
    and at least 0.15 new views a second. Hypotheses below 1 % of the belief keep their regime.

    Args:
        hypotheses: Before the motion.
        odometry: The motion.
        odometry_bias: Its bias.
        noise: Of the images, whose lengths make a view a new one.
        since_s: Seconds since the last image: what failed before it shows at the next.
        failures_per_s: Rate at which odometry begins to fail.
        failure_s: How long that lasts on average, seconds.

    Source: Blom and Bar-Shalom, "The interacting multiple model algorithm for systems with Markovian switching
    coefficients", 1988.
    """
    duration_s = odometry.duration_s
    if failures_per_s * since_s <= 0.0:
        return hypotheses
    heavy, is_right = hypotheses.log_weights > math.log(_HEAVY), hypotheses.regime == RIGHT
    right, failed = (heavy & is_right).nonzero()[0], (heavy & ~is_right).nonzero()[0]
    fails = min(-math.expm1(-failures_per_s * since_s), _MOST)
    ceases = min(-math.expm1(-since_s / failure_s), 1.0 - 1e-9)
    unit, lengths = drift_of(odometry, odometry_bias), np.repeat([noise.length_m, noise.length_rad], 3)
    wrong = np.hypot(_SLIP_PER_S * duration_s * lengths, odometry.tangent)
    wrong = np.minimum(wrong / np.where(unit > 0.0, unit, np.inf), _FARTHEST) + (unit == 0.0)
    known, of_known = odometry_bias_of(hypotheses)
    switches = (
        (right, fails / 2.0, BIASED, np.zeros(6), np.diag(np.square(wrong))),
        (right, fails / 2.0, USELESS, np.zeros(6), np.eye(6)),
        (failed, ceases, RIGHT, known[1:], of_known[1:, 1:]),
    )
    end = len(hypotheses)
    after = hypotheses[np.concatenate([np.arange(end), *(of for of, *_ in switches)])]
    after.log_weights[right] += math.log1p(-fails)
    after.log_weights[failed] += math.log1p(-ceases)
    for of, part, regime, mean, covariance in switches:
        own, end = slice(end, end + len(of)), end + len(of)
        after.log_weights[own] += np.log(part)
        after.regime[own] = regime
        set_drift(after[own], mean, covariance)
    return after


def unknown_velocity(noise: MeasurementNoise, gap: GapConfig) -> OdometryBias:
    """The velocity of a camera whose odometry is useless: two new views a second, and turns as in a gap."""
    speed, turn = min(_VIEWS_PER_S * noise.length_m, _FASTEST), gap.turn_rad_per_s
    return OdometryBias(scale=0.0, drift=(speed, speed, speed, turn, turn, turn), time_s=gap.time_s)


def leaps(odometry: Odometry, usual_m_per_s: float, noise: MeasurementNoise) -> bool:
    """Whether a motion is further than a new view, and ten times as fast as usual: a reset pose, or a jump of tracking.

    Args:
        odometry: The motion.
        usual_m_per_s: See `usual_speed`; at least two new views a second are usual.
        noise: Of the images, whose lengths make a view a new one.
    """
    distance_m = float(np.linalg.norm(odometry.tangent[:3]))
    fastest = _LEAP * max(_VIEWS_PER_S * noise.length_m, usual_m_per_s)
    return distance_m > noise.length_m and 0.0 < fastest * odometry.duration_s < distance_m


def usual_speed(before_m_per_s: float, odometry: Odometry) -> float:
    """The average speed by odometry over some seconds, after a motion."""
    if odometry.duration_s <= 0.0:
        return before_m_per_s
    speed = float(np.linalg.norm(odometry.tangent[:3])) / odometry.duration_s
    return before_m_per_s - float(np.expm1(-odometry.duration_s / _USUAL_S)) * (speed - before_m_per_s)


def moved(
    hypotheses: Hypotheses,
    odometry: Odometry,
    odometry_bias: OdometryBias,
    velocity: OdometryBias,
    distances: Sequence[float],
) -> Hypotheses:
    """Hypotheses after a motion: by odometry, or by their own velocity where it is useless.

    Args:
        hypotheses: Before.
        odometry: The motion.
        odometry_bias: Its bias.
        velocity: See `unknown_velocity`.
        distances: Normalized distance that the camera of each source moved.
    """
    useless = hypotheses.regime == USELESS
    own, others = useless.nonzero()[0], (~useless).nonzero()[0]
    if len(own) == 0:
        return predict(hypotheses, odometry, odometry_bias, distances)
    parts = [across_gap(hypotheses[own], Gap.of(None, odometry.duration_s, velocity), distances)]
    if len(others):
        parts.append(predict(hypotheses[others], odometry, odometry_bias, distances))
    return concatenate(parts)[np.concatenate([own, others]).argsort()]


def drift_of(odometry: Odometry, odometry_bias: OdometryBias) -> Float64[np.ndarray, " 6"]:
    """Standard deviation of the drift's share in an increment, each axis, metres and radians."""
    duration_s = min(odometry.duration_s, _LONGEST_S)
    if odometry_bias.drift is None:
        return odometry_bias.relative_drift * np.sqrt(odometry.covariance.diagonal() * duration_s)
    return np.asarray(odometry_bias.drift) * duration_s


class Gap(NamedTuple):
    """A motion without odometry, in which a hypothesis moves by the velocity that its drift is then.

    Attributes:
        known: What is known of it: that it lasts so long, or also how the camera turned; the translation is 0.
        velocity: What is unknown, as the drift of such odometry.
    """

    known: Odometry
    velocity: OdometryBias

    @staticmethod
    def of(odometry: Odometry | None, elapsed_s: float, velocity: OdometryBias) -> Gap:
        """The gap of a motion that is unknown, of so many seconds, or of which the rotation alone is known.

        Args:
            odometry: Whose translation does not count; None where nothing is known.
            elapsed_s: Seconds of it, where nothing is known.
            velocity: `GapConfig.velocity`, or `unknown_velocity`.
        """
        if odometry is None:
            return Gap(Odometry.still(elapsed_s), velocity)
        rotation, covariance = odometry.previous_from_current.rotation, odometry.covariance.copy()
        covariance[:3] = covariance[:, :3] = 0.0
        known = Odometry(Poses(rotation, np.zeros(3)), covariance, odometry.duration_s)
        drift = velocity.drift or (0.0,) * 6
        return Gap(known, unchecked_replace(velocity, drift=(*drift[:3], 0.0, 0.0, 0.0)))


def across_gap(hypotheses: Hypotheses, gap: Gap, distances: Sequence[float]) -> Hypotheses:
    """Hypotheses after a motion without odometry.

    Args:
        hypotheses: Before.
        gap: The motion.
        distances: Normalized distance that the camera of each source likely moved.
    """
    moved = predict(hypotheses, gap.known, gap.velocity, distances)
    limit_rotation(moved.covariance)
    return moved


def gap_motion(hypotheses: Hypotheses, unseen_s: float, gap: Gap, config: GapConfig) -> GapMotion:
    """The motion without odometry, by the velocity of the heaviest hypothesis.

    A velocity lasts for a time (`GapConfig.time_s`). For longer without an image the camera may be anywhere, but it
    turned as far as is known.

    Args:
        hypotheses: Before, whose drift is in units of `GapConfig.velocity`.
        unseen_s: Seconds since the latest image, before it.
        gap: The motion.
        config: Settings.
    """
    drift = hypotheses.mean[int(np.argmax(hypotheses.log_weights)), 1:7]
    likely = gap.known.previous_from_current @ Poses.exp(_errors_of(gap.known, gap.velocity)[:, 1:] @ drift)
    ends_s = unseen_s, unseen_s + gap.known.duration_s
    before_s, after_s = (max(each - config.time_s, 0.0) for each in ends_s)
    unknown_s, turns = after_s - before_s, gap.velocity.drift is not None and any(gap.velocity.drift[3:])
    return GapMotion(likely, config.speed_m_per_s * unknown_s, config.turn_rad_per_s * unknown_s if turns else 0.0)


def limit_rotation(covariance: Float64[np.ndarray, "n d d"]) -> None:
    """Limit standard deviations of rotation, in place, to one at which all directions are open."""
    turned = np.arange(3, 6)
    scale = np.ones(covariance.shape[:2])
    scale[:, turned] = np.minimum(1.0, _WIDEST_RAD / np.sqrt(covariance[:, turned, turned]))
    covariance *= scale[:, :, None] * scale[:, None, :]


def _moved_covariance(covariance: Float64[np.ndarray, "n d d"], motion: StateMotion) -> Float64[np.ndarray, "n d d"]:
    """F C Fᵀ and the noise."""
    pose, kept, noise = motion
    size = len(noise)
    scale = np.concatenate([np.ones(6), kept])
    scales = np.multiply.outer(scale, scale)
    moved = np.empty_like(covariance)
    for block in blocks(len(covariance)):
        before, after = covariance[block], moved[block]
        half = (before.reshape(-1, size)[:, :13] @ pose.T).reshape(-1, size, 6)
        np.multiply(before, scales, out=after)
        after[:, POSE, POSE] = pose @ half[:, :13]
        after[:, 6:, POSE] = across = half[:, 6:] * kept[:, None]
        after[:, POSE, 6:] = np.swapaxes(across, 1, 2)
        settle(after[:, POSE, POSE])
        after += noise
    return moved
