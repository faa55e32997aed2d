"""The scale of the measurement noise, from odometry while the camera moves.

Two images some distance apart give the motion between them, and odometry gives it more exactly. Where the two differ by
more than the noise allows, as in another light or in a part of the map that the held-out images did not show, the noise
is larger than stated; where they differ by less, it is smaller (innovation-based adaptive estimation; Mehra, 1970). An
error that all images share does not show.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float64

from filtering.measurement_noise import MeasurementNoise
from filtering.moments import settle
from filtering.motion import Odometry
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from filtering.unchecked import unchecked_replace

_APART = 2.0  # normalized distance between two images that are compared: nearer ones err alike
_LEAST = 0.1  # of the variance
_DRAWS = 20_000
_OUTLIER = 6.0  # times the variance expected: more is an outlier
_BELIEVED = 5.0  # comparisons that the stated noise is worth
_REMEMBERED = 50.0  # comparisons
_LATELY = 5.0  # normalized distance that a belief's information comes from


@dataclass(frozen=True)
class ErrorScale:
    """The factor of the variance of a source's noise.

    Attributes:
        adapts: Whether odometry may change it.
        place: world_from_camera by the image that the next one is compared with, one pose; None where there is none.
        covariance: Of its error, (6, 6).
        since: Motion of the camera since.
        normalized_distance: Of that motion, in lengths over which the errors of images are correlated.
        total: Sum of the squared differences, each over its expectation.
        count: Their number; old ones are forgotten.
        information: Of recent images, over that of one with the stated noise: more where images resemble the training
            images.
    """

    adapts: bool = True
    place: Poses | None = None
    covariance: Float64[np.ndarray, "6 6"] | None = None
    since: Odometry | None = None
    normalized_distance: float = 0.0
    total: float = _BELIEVED
    count: float = _BELIEVED
    information: float = 1.0

    @property
    def factor(self) -> float:
        """Of the variance."""
        return max(_LEAST, self.total / self.count) if self.adapts else 1.0

    def applied(self, noise: MeasurementNoise) -> MeasurementNoise:
        """The noise with this factor; constant errors in proportion to the information of recent images."""
        constant = noise.constant_fraction / max(self.information, 1e-3)
        return unchecked_replace(noise, constant_fraction=min(constant, 1e3)).inflated(self.factor)

    def predict(self, camera_motion: Odometry, normalized_distance: float) -> ErrorScale:
        """After a motion of the camera."""
        if self.place is None:
            return self
        since = camera_motion if self.since is None else self.since.then(camera_motion)
        return unchecked_replace(self, since=since, normalized_distance=self.normalized_distance + normalized_distance)

    def observe(self, posterior: PosePosterior, normalized_distance: float) -> ErrorScale:
        """After an informative image of the camera, which moved so far since the last one."""
        follow = -np.expm1(-normalized_distance / _LATELY)
        information = self.information + follow * (1.0 / posterior.growth - self.information)
        return unchecked_replace(self, information=float(information))._compared(posterior)

    def _compared(self, posterior: PosePosterior) -> ErrorScale:
        heaviest = int(np.argmax(posterior.weights))
        if self.place is None or self.covariance is None:
            return self._from(posterior, heaviest)
        if self.normalized_distance < _APART or self.since is None:
            return self
        expected = self.place @ self.since.previous_from_current
        difference = expected.between(posterior.means).log()
        carry = self.since.carry
        new = 1.0 - posterior.noise.correlated_fraction * np.exp(-self.normalized_distance)
        of_images = new * (carry @ self.covariance @ carry.T + posterior.covariances)
        expected_covariance = of_images + self.since.noise
        settle(expected_covariance)
        information = np.linalg.inv(expected_covariance)
        squared = np.maximum(np.einsum("ki,kij,kj->k", difference, information, difference), 0.0) / 6.0
        nearest = int(np.argmin(squared))
        if squared[nearest] > _OUTLIER * max(1.0, self.factor):
            return self._from(posterior, heaviest)
        # Where odometry is less exact than images, a difference shows the error of odometry.
        worth = float(np.trace(information[nearest] @ of_images[nearest])) / 6.0
        kept = min(1.0, _REMEMBERED / (self.count + worth))
        usual = _usual(posterior.noise.degrees_of_freedom) if posterior.calibrated else 1.0
        found = worth * float(squared[nearest]) / usual
        scale = unchecked_replace(self, total=kept * (self.total + found), count=kept * (self.count + worth))
        return scale._from(posterior, nearest)

    def _from(self, posterior: PosePosterior, place: int) -> ErrorScale:
        pose, covariance = posterior.means[place], posterior.covariances[place]
        return unchecked_replace(self, place=pose, covariance=covariance, since=None, normalized_distance=0.0)


@cache
def _usual(degrees_of_freedom: float) -> float:
    """Mean square, without outliers, of the difference of two errors with such tails."""
    rng = np.random.default_rng(0)
    errors = rng.standard_normal((2, _DRAWS, 6)) / np.sqrt(
        rng.chisquare(degrees_of_freedom, (2, _DRAWS, 1)) / degrees_of_freedom
    )
    squared = np.square(errors[0] - errors[1]).sum(axis=1) / 12.0
    return float(squared[squared < _OUTLIER].mean())
