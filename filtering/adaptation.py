"""Whether images err more than their model says: told from odometry while the camera moves.

Two images some way apart say how the camera moved between them, and odometry says it better. Where the two differ by
more than the errors of images allow, the errors are larger: in a part of the map that the held-out images did not show,
or in another light (innovation-based adaptive estimation; Mehra, 1970).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from jaxtyping import Float64
from scipy.stats import f as fisher

from filtering.motion import Odometry
from filtering.posterior import PosePosterior
from filtering.se3 import Poses

_APART = 0.5  # way between two images that are compared, lengths: nearer ones err alike
_OUTLIER = 6.0  # times the variance expected: further off is another place, or an image that errs in a way of its own
_BELIEVED = 5.0  # comparisons that the model is worth before the first one
_REMEMBERED = 50.0  # comparisons


@dataclass(frozen=True)
class ErrorScale:
    """How much larger than modelled the variance of a camera's errors is.

    Attributes:
        place: world_from_camera by the image that the next one is compared with, one pose; None where there is none.
        covariance: Of its error, (6, 6).
        since: Motion of the camera since.
        way: How far that is, in lengths over which the errors of images change.
        total: Sum of the squared differences found, each over what the model expects of it.
        count: Their number; old ones are forgotten.
    """

    place: Poses | None = None
    covariance: Float64[np.ndarray, "6 6"] | None = None
    since: Odometry | None = None
    way: float = 0.0
    total: float = _BELIEVED
    count: float = _BELIEVED

    @property
    def factor(self) -> float:
        """Of the variance, at least 1: images that seem to err less than modelled may all err alike."""
        return max(1.0, self.total / self.count)

    def moved(self, camera_motion: Odometry, way: float) -> ErrorScale:
        """After a motion of the camera, and its way in lengths."""
        if self.place is None:
            return self
        since = camera_motion if self.since is None else self.since.then(camera_motion)
        return replace(self, since=since, way=self.way + way)

    def looked(self, posterior: PosePosterior) -> ErrorScale:
        """After an image of the camera that says something."""
        heaviest = int(np.argmax(posterior.shares))
        if self.place is None or self.covariance is None:
            return self._from(posterior, heaviest)
        if self.way < _APART or self.since is None:
            return self
        expected = self.place @ self.since.previous_from_current
        difference = (expected.inverse() @ posterior.means).log()
        carry = self.since.previous_from_current.inverse().adjoint()
        new = 1.0 - posterior.errors.lasting_share * np.exp(-self.way)
        spread = new * (carry @ self.covariance @ carry.T + posterior.covariances) + self.since.covariance
        squared = np.einsum("ki,ki->k", difference, np.linalg.solve(spread, difference[..., None])[..., 0]) / 6.0
        nearest = int(np.argmin(squared))
        if squared[nearest] > _OUTLIER * self.factor:
            return self._from(posterior, heaviest)
        kept = min(1.0, _REMEMBERED / (self.count + 1.0))
        found = float(squared[nearest]) / _usual(posterior.errors.tail)
        scale = replace(self, total=kept * (self.total + found), count=kept * (self.count + 1.0))
        return scale._from(posterior, nearest)

    def _from(self, posterior: PosePosterior, place: int) -> ErrorScale:
        pose, covariance = posterior.means[place], posterior.covariances[place]
        return replace(self, place=pose, covariance=covariance, since=None, way=0.0)


@cache
def _usual(tail: float) -> float:
    """Usual where the model is true: mean of min(F, 6), F of Fisher's distribution with 6 and `tail`."""
    values = np.linspace(0.0, _OUTLIER, 601)
    return float(np.trapezoid(fisher.sf(values, 6, tail), values))
