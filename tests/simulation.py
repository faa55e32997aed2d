"""A simulated climb past identical floors, with an oracle for a posterior: the filter without a network."""

from dataclasses import dataclass

import numpy as np

from filtering.density import KernelDensity
from filtering.motion import Odometry
from filtering.posterior import PosteriorSamples
from filtering.se3 import Poses

FLOOR_HEIGHT_M = 3.0
ODOMETRY_STD = np.array([0.005] * 3 + [0.003] * 3)
POSTERIOR_STD = np.array([0.15] * 3 + [0.1] * 3)


@dataclass(frozen=True)
class Oracle:
    """An observation model that knows the truth: equal modes on all floors, or the true one where it is unique.

    An image carries only its frame's index, in its first two values.
    """

    truth: Poses
    floors: tuple[int, ...]
    unique: range

    def observe(self, image, *, rng):
        index = int(image[0, 0, 0]) + 256 * int(image[0, 0, 1])
        floors = (0,) if index in self.unique else self.floors
        samples = self.truth[index] @ Poses.exp(rng.standard_normal((500, 6)) * POSTERIOR_STD)
        lift = np.zeros((500, 3))
        lift[:, 2] = FLOOR_HEIGHT_M * rng.choice(floors, 500)
        return PosteriorSamples(KernelDensity(Poses(samples.rotation, samples.translation + lift), 0.1, 0.1))


def image_of(index):
    image = np.zeros((2, 2, 3), np.uint8)
    image[0, 0, :2] = index % 256, index // 256
    return image


def climb(num_frames, *, rng):
    """True poses (n,) of a walk up, and noisy odometry between them (the first None)."""
    truth, odometry = [Poses.exp(np.array([0.0, 0, 6, 0, 0, 0]))], [None]
    for i in range(1, num_frames):
        delta = Poses.exp(np.array([0.08, 0, 0.03, 0, 0, 0.02 * np.sin(i / 10)]))
        truth.append(truth[-1] @ delta)
        measured = delta @ Poses.exp(rng.standard_normal(6) * ODOMETRY_STD)
        odometry.append(Odometry(measured, np.diag(ODOMETRY_STD**2)))
    return Poses.stack(truth), odometry
