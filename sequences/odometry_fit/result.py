"""The fitted errors of odometry."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from jaxtyping import Float64

from filtering.motion import Odometry, OdometryBias, accumulated
from sequences.errors import SequenceError

Six = tuple[float, float, float, float, float, float]


@dataclass(frozen=True)
class OdometryFit:
    """How wrong odometry was found to be, axis by axis of (v, ω) in the camera frame.

    Attributes:
        white_per_s: Variance of the white noise that comes in a second, m²/s and rad²/s.
        white_per_m: Variance that comes in a metre on top of it, m²/m and rad²/m; zeros where the data leave it open.
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
    def odometry_bias(self) -> OdometryBias:
        """The odometry bias, as the filter takes it."""
        return OdometryBias(scale=self.scale_std, drift=self.drift, time_s=self.time_s)

    def along(
        self, tangent: Float64[np.ndarray, "*batch 6"], duration_s: Float64[np.ndarray, "*batch"]
    ) -> Float64[np.ndarray, "*batch 6"]:
        """See `WhiteNoise.along`."""
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

        Raises SequenceError where a value is missing, one too many, or no number, or there are other than six for an
        axis each.
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
            numbers[entry.name] = six(value) if shape else int(value) if entry.type == "int" else float(value)
        return cls(**numbers)

    def __str__(self) -> str:
        """A few lines for people: standard deviations, millimetres and degrees."""

        def row(values: Six, errors: Six | None = None) -> str:
            axes = ((np.array(values[:3]) * 1e3, " mm"), (np.degrees(values[3:]), "°"))
            parts = [" ".join(f"{v:.2g}" for v in numbers) + unit for numbers, unit in axes]
            if errors is not None:
                found = ["?" if e > 9.99 else f"{100 * e:.0f}" for e in errors]
                parts = [f"{part} (± {' '.join(found[i : i + 3])} %)" for part, i in zip(parts, (0, 3), strict=True)]
            return ", ".join(parts)

        per_m = f"\n  white after 1 m, on top: {row(six(np.sqrt(self.white_per_m)))}" if any(self.white_per_m) else ""
        return (
            f"odometry, from {self.increments} increments ({self.seconds:.0f} s, {self.metres:.1f} m,"
            f" {self.recordings} recording{'s' if self.recordings > 1 else ''}; {self.clipped} errors cut):\n"
            f"  white after 1 s: {row(six(np.sqrt(self.white_per_s)), self.white_error)}{per_m}\n"
            f"  drift in 1 s:    {row(self.drift, self.drift_error)}, changes over {self.time_s:.0f} s\n"
            f"  scale: {100 * self.scale:+.1f} ± {100 * self.scale_error:.1f} %, standard deviation taken:"
            f" {100 * self.scale_std:.1f} %\n"
            f"  noise of single poses: {row(self.pose_noise)}"
        )


def six(values: np.ndarray) -> Six:
    """Six numbers of an array, (6,)."""
    a, b, c, d, e, f = (float(value) for value in values)
    return a, b, c, d, e, f
