"""Weights of places that landmarks verify, fitted on held-out images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float64
from scipy.optimize import minimize
from scipy.stats import f as fisher

from filtering.mapped_views import MOST_ELSEWHERE, unshown
from filtering.measurement_noise import MeasurementNoise
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from vapor.calibration.verified_errors import LeaveOut
from vapor.landmarks.localize import VerifiedPose
from vapor.landmarks.verify import Verification, proposed_weights

_BELIEVED = np.array([1.5, 0.5, 1.0, 1.0])
"""Prior standard deviations of log gain, power, log unproposed and log clutter."""
_REGION = 0.99
_NONE_RIGHT = 0.5, 10.0  # prior: images without a right verified place, of all images
_OUTLIERS = 0.005, 0.9
_REACHES = np.geomspace(0.1, 3.0, 35)
_REACH_STD = 0.7  # prior standard deviation of the logarithm
_OF_SHOWN = np.linspace(0.5, 1.0, 11)  # fractions of images of shown places that are verified
_ELSEWHERE = 0.5, 10.0  # prior: images with a verified place elsewhere, of all images


@dataclass(frozen=True)
class SeenPlaces:
    """The places of one held-out image with j verified poses.

    Attributes:
        inliers: Landmarks of each verified pose.
        proposed: The network's weight of the place of each.
        right: Whether each is at the true pose.
        others: Weight of all places of the network.
        others_right: Weight of its places at the true pose.
    """

    inliers: Float64[np.ndarray, " j"]
    proposed: Float64[np.ndarray, " j"]
    right: Bool[np.ndarray, " j"]
    others: float
    others_right: float

    @staticmethod
    def of(
        posterior: PosePosterior, found: Sequence[VerifiedPose], truth: Poses, *, near_m: float, near_rad: float
    ) -> SeenPlaces:
        """The places of an image; a verified pose within `near_m` and `near_rad` of the true one is right."""
        poses = Poses.stack([each.world_from_camera for each in found])
        metres, radians = poses.distance(truth)
        offset = posterior.means.between(truth).log()
        squared = np.einsum("ki,kij,kj->k", offset, np.linalg.inv(posterior.covariances), offset)
        inside = squared < 6.0 * fisher.ppf(_REGION, 6, posterior.noise.degrees_of_freedom)
        return SeenPlaces(
            np.array([float(each.inliers) for each in found]),
            proposed_weights(posterior, poses),
            (metres < near_m) & (radians < near_rad),
            float(posterior.weights.sum()),
            float(posterior.weights[inside].sum()),
        )

    def possible(self, settings: Verification, noise: MeasurementNoise) -> float:
        """How possible the true place is, as in `PosePosterior.possible`, with the noise of verified places."""
        scores = settings.scores(self.inliers, self.proposed)
        if self.right.any():
            return min(float(noise.possible(scores)[self.right].sum()), 1.0)
        return min(self.others_right / max(float(scores.sum()), 1e-300), 1.0)

    def log_likelihood(self, settings: Verification) -> float:
        """Log probability of the true pose: at a verified place, else at another."""
        scores = settings.scores(self.inliers, self.proposed)
        right = float(scores[self.right].sum()) if self.right.any() else self.others_right
        total = float(scores.sum()) + self.others + settings.clutter
        return float(np.log((right if right > 0.0 else settings.clutter) / total))


def fit_reach(left_out: LeaveOut, effective: float) -> Verification:
    """Settings with `reach` and `elsewhere` fitted to training images, worth `effective` independent ones."""
    right = np.zeros(len(left_out.found), bool)
    right[[row for row, _ in left_out.right]] = True
    worth = min(1.0, effective / max(len(right), 1))
    before = Verification()

    def log_posterior(reach: float) -> float:
        probability = np.clip(np.outer(_OF_SHOWN, 1.0 - unshown(left_out.view_distance, reach)), 1e-3, 1.0 - 1e-3)
        likelihood = np.log(np.where(right, probability, 1.0 - probability)).sum(axis=1).max()
        return worth * float(likelihood) - 0.5 * (np.log(reach / before.reach) / _REACH_STD) ** 2

    reach = float(max(_REACHES, key=log_posterior))
    mistaken, of = _ELSEWHERE
    elsewhere = (worth * float(left_out.alike.sum()) + mistaken) / (worth * len(right) + of)
    return replace(before, reach=reach, elsewhere=min(elsewhere, MOST_ELSEWHERE))


def fit_verification(images: Sequence[SeenPlaces], effective: float, before: Verification) -> Verification:
    """Weights of verified places of maximum posterior; other settings are kept.

    `effective` is the number of independent images with the information of the held-out ones.
    """
    if not images:
        return before
    worth = min(1.0, effective / len(images))

    start = _numbers(before)

    def cost(numbers: np.ndarray) -> float:
        settings = _settings(numbers, before)
        likelihood = worth * sum(each.log_likelihood(settings) for each in images)
        return 0.5 * float(np.square((numbers - start) / _BELIEVED).sum()) - likelihood

    found = minimize(cost, start, method="Nelder-Mead", options={"xatol": 0.02, "fatol": 1e-3, "maxiter": 400})
    return _settings(found.x, before)


def evidence(
    images: Sequence[SeenPlaces], settings: Verification, noise: MeasurementNoise
) -> Float64[np.ndarray, " n"]:
    """Log likelihood of the true place by each image, as in the filter, with the noise of verified places."""
    possible = np.array([each.possible(settings, noise) for each in images])
    return np.log(noise.outlier_probability + (1.0 - noise.outlier_probability) * possible)


def none_right(images: Sequence[SeenPlaces], effective: float) -> float:
    """Probability that no verified place of an image is right, by images worth `effective` independent ones."""
    worth = min(1.0, effective / max(len(images), 1))
    wrong = worth * sum(1 for each in images if not each.right.any())
    wrong_before, before = _NONE_RIGHT
    return float(np.clip((wrong + wrong_before) / (worth * len(images) + before), *_OUTLIERS))


def _numbers(settings: Verification) -> Float64[np.ndarray, "4"]:
    return np.array([np.log(settings.gain), settings.power, np.log(settings.unproposed), np.log(settings.clutter)])


def _settings(numbers: Float64[np.ndarray, "4"], others: Verification) -> Verification:
    gain, unproposed, nothing = (float(np.exp(np.clip(numbers[i], -6.0, 6.0))) for i in (0, 2, 3))
    power = float(np.clip(numbers[1], 0.0, 5.0))
    return replace(others, gain=gain, power=power, unproposed=min(unproposed, 1.0), clutter=nothing)
