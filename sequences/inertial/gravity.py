"""The direction of gravity by an accelerometer and a gyroscope: a complementary filter with variances.

Source: Mahony, Hamel and Pflimlin, "Nonlinear complementary filters on the special orthogonal group", 2008, of which
this is the part that needs no heading; the gains are those of a Kalman filter of one angle and one bias.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from sequences.frame import Gravity
from sequences.inertial.rows import TimedRows
from sequences.inertial.samples import STANDARD_GRAVITY, InertialSamples

_GAP_S, _RECENT_S = 0.5, 0.1  # without samples: it begins anew; of the sample for a frame
_STEADY_G, _LASTS_S = 0.01, 1.0  # accelerations of a frame that moves evenly; how long they last
_AVERAGED_S, _UNSEEN_G = 0.2, 0.005  # of a length; its deviation at the beginning: a force of 0.1 g across
_OTHERWISE_G = 0.2  # samples that differ from gravity by more say nothing of it
_DRIFT_RAD_PER_SQRT_S, _UNKNOWN_TURN = 0.002, 0.5  # of a gyroscope whose bias is known; without one
_BIAS_RAD_PER_S, _BIAS_CHANGES = 0.02, 1e-4  # standard deviations: of the bias, of its change in a second
_UNKNOWN_RAD = 0.5  # standard deviation from which on gravity is as good as unknown
_MOUNT_RAD = 0.01  # standard deviation of how the unit is mounted


class GravityFilter:
    """Up about the axes of the camera: by the unit's own orientation, or by specific force and turn rate.

    The turn rate carries the direction on, and specific forces pull it back, the less so the more their length varies:
    then the frame accelerates. Accelerations last for a second, so that the rate of the samples does not matter. What
    pulls the same way all the time is the bias of the turn rate.
    """

    def __init__(self) -> None:
        """Before the first sample."""
        self._found = TimedRows(4)  # up and its standard deviation, NaN where unknown
        self._last_ns: int | None = None
        self._up: np.ndarray | None = None
        self._bias, self._off, self._smooth = np.zeros(3), _UNSEEN_G, 0.0
        # Variances of the direction and of the bias about each axis, and their covariance.
        self._of_up, self._both, self._of_bias = 0.0, 0.0, _BIAS_RAD_PER_S**2

    def extend(self, samples: InertialSamples) -> None:
        """Take samples, one at least, that are later than those before."""
        if samples.up is not None:
            std_rad = np.where(np.isfinite(samples.up[:, 0]), np.hypot(samples.up_std_rad, _MOUNT_RAD), np.nan)
            found = np.column_stack([samples.up, std_rad])
        else:
            found = self._filtered(samples)
        self._last_ns = int(samples.times_ns[-1])
        self._found.extend(samples.times_ns, found)

    def at(self, time_ns: int) -> Gravity | None:
        """Gravity at a time, by the latest sample within a tenth of a second before; None where it is unknown."""
        times_ns = self._found.times_ns
        at = int(np.searchsorted(times_ns, time_ns, side="right")) - 1
        if at < 0 or (age_s := (time_ns - int(times_ns[at])) * 1e-9) > _RECENT_S:
            return None
        x, y, z, std_rad = self._found.rows[at].tolist()
        std_rad = float(np.hypot(std_rad, _UNKNOWN_TURN * age_s))
        return Gravity((x, y, z), std_rad) if std_rad <= _UNKNOWN_RAD else None  # NaN compares as false

    def forget_before(self, time_ns: int) -> None:
        """Drop what only earlier times need."""
        self._found.forget_before(time_ns)

    def _filtered(self, samples: InertialSamples) -> Float64[np.ndarray, "n 4"]:
        found = np.full((len(samples.times_ns), 4), np.nan)
        before_ns = samples.times_ns[:1] if self._last_ns is None else [self._last_ns]
        spaced_s = np.diff(samples.times_ns, prepend=before_ns) * 1e-9
        lengths = np.linalg.norm(samples.force, axis=1) / STANDARD_GRAVITY
        for i, dt in enumerate(spaced_s.tolist()):
            if dt > _GAP_S:
                self._up, self._off, self._both = None, _UNSEEN_G, 0.0
            self._turn(samples.turn_rate[i], dt)
            if np.isfinite(lengths[i]):
                self._pull(samples.force[i], float(lengths[i]), samples.usual_g, dt)
            if self._up is not None:
                found[i] = *self._up, np.sqrt(self._of_up + _MOUNT_RAD**2)
        return found

    def _turn(self, rate: Float64[np.ndarray, "3"], dt: float) -> None:
        """Carry the direction on by a turn rate."""
        self._of_bias = min(self._of_bias + _BIAS_CHANGES**2 * dt, _BIAS_RAD_PER_S**2)
        if self._up is None:
            return
        if np.isnan(rate[0]):
            self._of_up += _UNKNOWN_TURN**2 * dt
            return
        self._up = _unit(self._up - np.cross(rate - self._bias, self._up) * dt)
        self._of_up += 2.0 * dt * self._both + dt**2 * self._of_bias + _DRIFT_RAD_PER_SQRT_S**2 * dt
        self._both += dt * self._of_bias

    def _pull(self, force: Float64[np.ndarray, "3"], length: float, usual: float, dt: float) -> None:
        """Correct the direction by a specific force, so long in units of gravity."""
        differs = np.clip(length / usual - 1.0, -_OTHERWISE_G, _OTHERWISE_G)
        self._smooth += min(dt / _AVERAGED_S, 1.0) * (differs - self._smooth)
        self._off += min(dt / _LASTS_S, 1.0) * (abs(self._smooth) - self._off)
        if abs(length - 1.0) >= _OTHERWISE_G:
            return
        measured = force / (length * STANDARD_GRAVITY)
        error = _STEADY_G**2 + 2.0 * self._off  # a force across gravity lengthens it by half its square
        if self._up is None:
            self._up, self._of_up, self._both = measured, error, 0.0
            return
        innovation = self._of_up + error * _LASTS_S / max(dt, 1e-6)
        gain, of_rate = self._of_up / innovation, self._both / innovation
        self._bias = self._bias + of_rate * np.cross(self._up, measured)
        self._up = _unit(self._up + gain * (measured - self._up))
        self._of_bias -= of_rate * self._both
        self._of_up, self._both = (1.0 - gain) * self._of_up, (1.0 - gain) * self._both


def _unit(direction: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "3"]:
    return direction / max(float(np.linalg.norm(direction)), 1e-12)
