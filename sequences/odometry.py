"""Odometry as a robot would report it, simulated from true poses."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from jaxtyping import Float64, Int64

from filtering.errors import counted, require_within
from filtering.se3 import Poses
from sequences.errors import SequenceError

STATED_OVER_S = 0.1
"""The stated covariance is honest for increments over this time: see `simulate_odometry`."""
_CAUTION = 1.25  # stated standard deviations are larger than the true ones by this factor


@dataclass(frozen=True)
class OdometryNoise:
    """Errors of visual-inertial or wheel odometry, as standard deviations.

    Scale error and biases add up over a walk, white noise averages out.
    """

    scale: float = 0.02
    """Constant error of the distance, as a fraction of it."""
    translation_bias_m_per_s: float = 0.008
    """Slowly varying error of the velocity, each axis."""
    heading_bias_rad_per_s: float = 0.0015
    """Slowly varying error of the turn rate about the body's z axis: about 1.5° in 10 m at walking pace."""
    bias_time_s: float = 30.0
    """Time over which the biases change."""
    translation_white_m_per_sqrt_s: float = 0.008
    """White noise of the velocity, as metres after one second."""
    rotation_white_rad_per_sqrt_s: float = 0.003
    """White noise of the turn rate, as radians after one second."""
    fixed_scale: float | None = None
    """The error of the distance in place of a random one, as a fraction of it: at 0.02 odometry is 2 % too long. The
    stated covariance goes by `scale` all the same."""

    def __post_init__(self) -> None:
        require_within(
            self,
            scale=(0.0, 10.0),
            translation_bias_m_per_s=(0.0, 1e3),
            heading_bias_rad_per_s=(0.0, 1e3),
            bias_time_s=(1e-3, 1e9),
            translation_white_m_per_sqrt_s=(0.0, 1e3),
            rotation_white_rad_per_sqrt_s=(0.0, 1e3),
        )
        if self.fixed_scale is not None:
            require_within(self, fixed_scale=(-1.0, 10.0))

    @property
    def settings(self) -> str:
        """Every number by its name, as files and reports state it."""
        return ", ".join(f"{key} {value:g}" for key, value in asdict(self).items() if value is not None)


def simulate_odometry(
    times_ns: Int64[np.ndarray, " k"],
    world_from_base: Poses,
    noise: OdometryNoise,
    *,
    rng: np.random.Generator,
) -> tuple[Poses, Float64[np.ndarray, "k 6 6"]]:
    """Dead-reckon a true trajectory with scale error, drift and noise.

    Args:
        times_ns: Stamps, strictly increasing.
        world_from_base: True poses of the body, batch (k,).
        noise: Standard deviations of the errors.
        rng: Source of the errors.

    Returns:
        odom_from_base, batch (k,), the first the identity; and for each the covariance of its twist (v, ω) in the body
        frame, (m/s)² and (rad/s)²: that of the motion since the message before. Increments taken as independent, each
        of covariance C dt², add up over 0.1 s to a slightly cautious statement of the error, scale and biases included;
        over much longer times biases grow faster than any independent increments do.

    Raises:
        SequenceError: stamps do not increase, or are not as many as the poses.
    """
    if len(times_ns) != len(world_from_base):
        raise SequenceError(
            f"odometry: {counted(len(times_ns), 'stamp')} for {counted(len(world_from_base), 'pose')}, expected as many"
        )
    if len(times_ns) and (np.diff(times_ns) <= 0).any():
        at = int(np.argmax(np.diff(times_ns) <= 0)) + 1
        raise SequenceError(f"odometry: stamp {times_ns[at]} ns follows {times_ns[at - 1]} ns, expected to increase")
    k = len(times_ns)
    if k < 2:
        return Poses.identity(k), np.zeros((k, 6, 6))
    dt = np.diff(times_ns) * 1e-9
    true = (world_from_base[:-1].inverse() @ world_from_base[1:]).log()
    drawn = noise.scale * rng.standard_normal()  # also where it is not used: the other errors stay the same
    scale = drawn if noise.fixed_scale is None else noise.fixed_scale
    bias_std = np.array([noise.translation_bias_m_per_s] * 3 + [0, 0, noise.heading_bias_rad_per_s])
    white_std = np.array([noise.translation_white_m_per_sqrt_s] * 3 + [noise.rotation_white_rad_per_sqrt_s] * 3)
    bias = _slow_noise(dt, noise.bias_time_s, rng) * bias_std
    white = rng.standard_normal((k - 1, 6)) * white_std * np.sqrt(dt)[:, None]
    measured = true + bias * dt[:, None] + white
    measured[:, :3] += scale * true[:, :3]
    increments = Poses.exp(measured)
    rotation, translation = np.empty((k, 3, 3)), np.zeros((k, 3))
    rotation[0] = np.eye(3)
    for i in range(k - 1):
        np.matmul(rotation[i], increments.rotation[i], out=rotation[i + 1])
    np.cumsum(Poses(rotation[:-1], np.zeros((k - 1, 3))).apply(increments.translation), axis=0, out=translation[1:])
    velocity = true[:, :3] / dt[:, None]
    covariance = np.zeros((k, 6, 6))
    covariance[1:, :3, :3] = noise.scale**2 * velocity[:, :, None] * velocity[:, None, :]
    covariance[1:] += np.diag(bias_std**2)
    # Increments dt apart that are summed as independent understate what is constant over 0.1 s: √(dt / 0.1 s).
    covariance[1:] *= np.maximum(STATED_OVER_S / dt, 1.0)[:, None, None]
    covariance[1:] += np.diag(white_std**2) / dt[:, None, None]
    covariance *= _CAUTION**2
    covariance[0] = covariance[1]
    return Poses(rotation, translation), covariance


def _slow_noise(dt: np.ndarray, time_s: float, rng: np.random.Generator) -> Float64[np.ndarray, "n 6"]:
    """An Ornstein-Uhlenbeck process of unit deviation, from its stationary distribution on."""
    keep = np.exp(-dt / time_s)
    value = rng.standard_normal((len(dt), 6))
    value[1:] *= np.sqrt(1 - keep[1:] ** 2)[:, None]
    for i in range(1, len(dt)):
        value[i] += keep[i] * value[i - 1]
    return value
