"""An inertial unit on the body of a synthetic sequence, simulated from true poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from filtering.se3 import Poses
from sequences.inertial.samples import STANDARD_GRAVITY


@dataclass(frozen=True)
class InertialNoise:
    """Errors of a small inertial unit, as standard deviations of each axis."""

    force_bias_m_per_s2: float = 0.05
    """Constant error of the specific force."""
    force_white_m_per_s2_per_sqrt_hz: float = 0.003
    """White noise of the specific force."""
    turn_bias_rad_per_s: float = 0.01
    """Constant error of the turn rate."""
    turn_white_rad_per_sqrt_s: float = 0.0003
    """White noise of the turn rate, as radians after one second."""
    mount_rad: float = 0.005
    """Error of how the unit is mounted, about each axis."""


def simulate_inertial(
    times_ns: Int64[np.ndarray, " k"], world_from_base: Poses, noise: InertialNoise, *, rng: np.random.Generator
) -> tuple[Float64[np.ndarray, "k 3"], Float64[np.ndarray, "k 3"]]:
    """Specific force, m/s², and turn rate, rad/s, about the axes of the body, of a unit at its origin.

    Args:
        times_ns: Stamps, evenly spaced, k ≥ 3.
        world_from_base: True poses in a world whose z is up, batch (k,).
        noise: Standard deviations of the errors.
        rng: Source of the errors.
    """
    step_s = float(np.median(np.diff(times_ns))) * 1e-9
    velocity = np.gradient(world_from_base.translation, step_s, axis=0)
    acceleration = np.gradient(velocity, step_s, axis=0)
    before, after = world_from_base[:-2], world_from_base[2:]
    turn = (before.inverse() @ after).log()[:, 3:] / (2.0 * step_s)
    turn = np.concatenate([turn[:1], turn, turn[-1:]])
    force = np.einsum("kji,kj->ki", world_from_base.rotation, acceleration + np.array([0.0, 0.0, STANDARD_GRAVITY]))
    mount = Poses.exp(np.append(np.zeros(3), noise.mount_rad * rng.standard_normal(3))).rotation
    force, turn = force @ mount, turn @ mount
    force += noise.force_bias_m_per_s2 * rng.standard_normal(3)
    force += noise.force_white_m_per_s2_per_sqrt_hz / np.sqrt(step_s) * rng.standard_normal(force.shape)
    turn += noise.turn_bias_rad_per_s * rng.standard_normal(3)
    turn += noise.turn_white_rad_per_sqrt_s / np.sqrt(step_s) * rng.standard_normal(turn.shape)
    return force, turn
