"""What methods are given of the images of a sequence, where posteriors and true poses are known beforehand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Int64

from filtering.error_model import ErrorModel
from filtering.motion import Odometry
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from sequences.odometry_fit.result import OdometryFit
from vapor.tracking.dead_reckoning import dead_reckoning


@dataclass(frozen=True)
class Passage:
    """What methods are given of n images, and the truth.

    Attributes:
        times_ns: Stamps, increasing, (n,).
        odometry: Camera motion since the image before, (n,); None where it is unknown. The first is not used.
        truth: True poses, world_from_camera, batch (n,).
        posterior: Gives the posterior of an image, by its number.
    """

    times_ns: Int64[np.ndarray, " n"]
    odometry: tuple[Odometry | None, ...]
    truth: Poses
    posterior: Callable[[int], PosePosterior]

    def restated(self, fit: OdometryFit | None) -> Passage:
        """The same with the white noise of the odometry as it was fitted; with None, as it is."""
        if fit is None:
            return self
        return replace(self, odometry=tuple(None if each is None else fit.restated(each) for each in self.odometry))

    def part(self, start: int, stop: int) -> Passage:
        """The images from one to before another, by their numbers, as a passage of its own."""
        return Passage(
            self.times_ns[start:stop],
            self.odometry[start:stop],
            self.truth[start:stop],
            lambda image: self.posterior(start + image),
        )

    @cached_property
    def dead_reckoning(self) -> Poses:
        """Poses from odometry alone, batch (n,); wherever odometry is missing they start anew at the true pose."""
        starts = [i for i, motion in enumerate(self.odometry) if i == 0 or motion is None]
        segments = zip(starts, [*starts[1:], len(self.odometry)], strict=True)
        return Poses.concatenate([dead_reckoning(self.truth[a], self.odometry[a:b]) for a, b in segments])


def posterior_of(samples: Poses, errors: ErrorModel, unfamiliarity: float) -> PosePosterior:
    """The posterior of an image by its samples; without any, one that says nothing, as of a camera that froze.

    See `ParticleLocalizer.observe`.
    """
    if len(samples):
        return PosePosterior.from_samples(samples, errors, unfamiliarity=unfamiliarity)
    return replace(PosePosterior.nothing(errors), unfamiliarity=unfamiliarity)
