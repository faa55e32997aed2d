"""The direction of gravity by an accelerometer and a gyroscope: a complementary filter with variances.

Source: Mahony, Hamel and Pflimlin, "Nonlinear complementary filters on the special orthogonal group", 2008, of which
this is the part that needs no heading; the gains are those of a Kalman filter of one angle and one bias.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from sequences.frame import Gravity
from sequences.inertial.samples import STANDARD_GRAVITY, InertialSamples

_GAP_S, _RECENT_S = 0.5, 0.1  # without samples: it begins anew; of the sample for a frame
_STEADY_G, _LASTS_S = 0.01, 1.0  # accelerations of a frame that moves evenly; how long they last
_AVERAGED_S, _UNSEEN_G = 0.2, 0.005  # of a length; its deviation at the beginning: a force of 0.1 g across
_OTHERWISE_G = 0.2  # samples that differ from gravity by more say nothing of it
_DRIFT_RAD_PER_SQRT_S, _UNKNOWN_TURN = 0.002, 0.5  # of a gyroscope whose bias is known; without one
_BIAS_RAD_PER_S, _BIAS_CHANGES = 0.02, 1e-4  # standard deviations: of the bias, of its change in a second
_UNKNOWN_RAD = 0.5  # standard deviation from which on gravity is as good as unknown
_MOUNT_RAD = 0.01  # standard deviation of how the unit is mounted


@dataclass(frozen=True)
class GravityTrack:
    """Up about the axes of the camera at n moments, and the standard deviation of each, radians; NaN where unknown."""

    times_ns: Int64[np.ndarray, " n"]
    up: Float64[np.ndarray, "n 3"]
    std_rad: Float64[np.ndarray, " n"]

    def at(self, time_ns: int) -> Gravity | None:
        """Gravity at a time, by the latest moment within a tenth of a second before; None where it is unknown."""
        at = int(np.searchsorted(self.times_ns, time_ns, side="right")) - 1
        if at < 0 or time_ns - int(self.times_ns[at]) > _RECENT_S * 1e9 or not np.isfinite(self.std_rad[at]):
            return None
        if self.std_rad[at] > _UNKNOWN_RAD:
            return None
        x, y, z = (float(each) for each in self.up[at])
        return Gravity((x, y, z), float(self.std_rad[at]))


def gravity_along(samples: InertialSamples) -> GravityTrack:
    """Gravity at each sample: by the unit's own orientation, or by specific force and turn rate.

    The turn rate carries the direction on, and specific forces pull it back, the less so the more their length varies:
    then the frame accelerates. Accelerations last for a second, so that the rate of the samples does not matter. What
    pulls the same way all the time is the bias of the turn rate.
    """
    if samples.up is not None:
        std = np.full(len(samples.times_ns), np.hypot(samples.up_std_rad, _MOUNT_RAD))
        return GravityTrack(samples.times_ns, samples.up, std)
    count = len(samples.times_ns)
    directions, stds = np.full((count, 3), np.nan), np.full(count, np.nan)
    spaced_s = np.diff(samples.times_ns, prepend=samples.times_ns[0]) * 1e-9
    lengths = np.linalg.norm(samples.force, axis=1) / STANDARD_GRAVITY
    up: np.ndarray | None = None
    usual = float(np.median(lengths[np.isfinite(lengths)])) if np.isfinite(lengths).any() else 1.0
    bias, off, smooth = np.zeros(3), _UNSEEN_G, 0.0
    # Variances of the direction and of the bias about each axis, and their covariance.
    of_up, both, of_bias = 0.0, 0.0, _BIAS_RAD_PER_S**2
    for i, dt in enumerate(spaced_s.tolist()):
        if dt > _GAP_S:
            up, off, both = None, _UNSEEN_G, 0.0
        rate = samples.turn_rate[i]
        of_bias = min(of_bias + _BIAS_CHANGES**2 * dt, _BIAS_RAD_PER_S**2)
        if up is not None and np.isnan(rate[0]):
            of_up += _UNKNOWN_TURN**2 * dt
        elif up is not None:
            up = _unit(up - np.cross(rate - bias, up) * dt)
            of_up += 2.0 * dt * both + dt**2 * of_bias + _DRIFT_RAD_PER_SQRT_S**2 * dt
            both += dt * of_bias
        length = lengths[i]
        if np.isfinite(length):
            smooth += min(dt / _AVERAGED_S, 1.0) * (np.clip(length / usual - 1.0, -_OTHERWISE_G, _OTHERWISE_G) - smooth)
            off += min(dt / _LASTS_S, 1.0) * (abs(smooth) - off)
            if abs(length - 1.0) < _OTHERWISE_G:
                measured = samples.force[i] / (length * STANDARD_GRAVITY)
                error = _STEADY_G**2 + 2.0 * off  # a force across gravity lengthens it by half its square
                if up is None:
                    up, of_up, both = measured, error, 0.0
                else:
                    innovation = of_up + error * _LASTS_S / max(dt, 1e-6)
                    gain, of_rate = of_up / innovation, both / innovation
                    bias = bias + of_rate * np.cross(up, measured)
                    up = _unit(up + gain * (measured - up))
                    of_bias -= of_rate * both
                    of_up, both = (1.0 - gain) * of_up, (1.0 - gain) * both
        if up is not None:
            directions[i], stds[i] = up, np.sqrt(of_up + _MOUNT_RAD**2)
    return GravityTrack(samples.times_ns, directions, stds)


def _unit(direction: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "3"]:
    return direction / max(float(np.linalg.norm(direction)), 1e-12)
