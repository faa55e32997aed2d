"""A posterior of your own drives the filter: no images, no network.

python examples/own_posterior.py

A robot drives along a corridor of ten doors, four metres apart: eight are white, the last two are blue and red. Its
detector proposes doors at which it may stand: eight equally possible places, or one.
"""

import numpy as np

import vapor

DOORS_M = 4.0 * np.arange(10.0)
ERRORS = vapor.MeasurementNoise(length_m=0.5, typical_std=(0.1, 0.1, 0.1, 0.05, 0.05, 0.05))  # of detections


def at(x_m: np.ndarray) -> vapor.Poses:
    """Poses (n,) on the corridor's axis."""
    x_m = np.atleast_1d(x_m)
    return vapor.Poses(np.tile(np.eye(3), (len(x_m), 1, 1)), np.stack([x_m, 0 * x_m, 0 * x_m], axis=1))


def detect(door: int, rng: np.random.Generator) -> vapor.PosePosterior:
    """The detector's posterior at a door: all white ones, or the one of that colour, each 10 cm and 3 degrees off."""
    doors = DOORS_M[[door]] if door >= 8 else DOORS_M[:8]
    return vapor.PosePosterior.from_estimates(at(doors + rng.normal(0.0, 0.1)), std_m=0.1, std_rad=0.05, noise=ERRORS)


def main() -> None:
    rng = np.random.default_rng(0)
    localizer = vapor.ParticleLocalizer(None, rng=rng)
    white_noise = np.diag([0.05**2] * 3 + [0.01**2] * 3)  # of the odometry, from door to door
    for door in range(4, 10):
        motion = vapor.Poses.exp(np.array([4.0 + rng.normal(0.0, 0.05), 0.0, 0.0, 0.0, 0.0, 0.0]))  # metres, radians
        odometry = vapor.Odometry(motion, white_noise, duration_s=4.0)
        estimate = localizer.update(detect(door, rng), odometry)
        best = estimate.modes[0]
        print(
            f"door {door}: {estimate.status:9s} {len(estimate.modes)} places, the best at"
            f" {best.world_from_camera.translation[0]:5.2f} m with {100 * best.weight:3.0f} %"
        )


if __name__ == "__main__":
    main()
