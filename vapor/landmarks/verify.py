"""An image's posterior, and the poses that landmarks verify -> one posterior.

The number of landmarks hardly decides between places that look alike, so a verified place keeps the network's weight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import cv2
import numpy as np
from jaxtyping import Float64, UInt8

from filtering.errors import require_within
from filtering.mapped_views import MappedViews
from filtering.measurement_noise import OUT_OF_DISTRIBUTION, PLACE, MeasurementNoise
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from sequences.frame import Camera
from vapor.cameras import AsTakenBy, same_view
from vapor.images import centre_crop, scale_to_cover
from vapor.landmarks.features import Features
from vapor.landmarks.landmark_map import LEAST_INLIERS, LandmarkMap, ViewCamera
from vapor.landmarks.localize import LandmarkLocalizer, VerifiedPose

Rgb = UInt8[np.ndarray, "h w 3"]


@dataclass(frozen=True)
class ShownLandmarks:
    """An image with its features, of which k are landmarks that agree with a pose, and m look like others near it.

    Attributes:
        image: RGB, of the size at which features are found.
        features: Pixels of features.
        disagreeing: Pixels of those that match landmarks near the pose, but lie elsewhere.
        seen: Pixels of the landmarks.
        predicted: Their projections from the pose.
        others: Number of landmarks of each other verified pose.
        number: Of the image in its run, from 0.
    """

    image: Rgb
    features: Float64[np.ndarray, "n 2"]
    disagreeing: Float64[np.ndarray, "m 2"]
    seen: Float64[np.ndarray, "k 2"]
    predicted: Float64[np.ndarray, "k 2"]
    others: tuple[int, ...]
    number: int


@dataclass(frozen=True)
class Verification:
    """Weights of verified places, found on held-out images."""

    gain: float = 50.0
    """Weight of a place that is verified by the least number of landmarks, in weights of the network."""
    power: float = 1.0
    """Power of the number of landmarks by which the weight grows."""
    unproposed: float = 0.1
    """Weight of the network that is assumed for a verified place that it did not propose."""
    clutter: float = 0.5
    """Weight of "none of these", in weights of the network."""
    reach: float = 0.5
    """Distance of a view from the most similar view of the map, in depths or radians, at which half are verified."""
    elsewhere: float = 0.05
    """Probability that landmarks verify another place of an image whose own the map does not show."""

    def __post_init__(self) -> None:
        require_within(self, gain=(1e-3, 1e6), power=(0.0, 5.0), unproposed=(1e-9, 1.0), clutter=(1e-9, 1e6))
        require_within(self, reach=(1e-3, 1e3), elsewhere=(0.0, 0.999))

    def scores(
        self, inliers: Float64[np.ndarray, " j"], weights: Float64[np.ndarray, " j"]
    ) -> Float64[np.ndarray, " j"]:
        """Weights of verified places with these network weights, comparable with the weights of other places."""
        return self.gain * (inliers / LEAST_INLIERS) ** self.power * (weights + self.unproposed)


def proposed_weights(posterior: PosePosterior, poses: Poses) -> Float64[np.ndarray, " j"]:
    """The weight of the place around each pose (j,), shared by the poses of one place; 0 outside all places."""
    weights = np.zeros(len(poses))
    if not len(posterior.weights) or not len(poses):
        return weights
    inside = _squared(posterior, poses) < PLACE**2 * 6.0
    near = np.where(inside, posterior.weights[:, None], 0.0)
    place = near.argmax(axis=0)
    taken = inside.any(axis=0)
    shared = np.bincount(place[taken], minlength=len(posterior.weights))
    weights[taken] = posterior.weights[place[taken]] / shared[place[taken]]
    return weights


def _squared(posterior: PosePosterior, poses: Poses) -> Float64[np.ndarray, "k j"]:
    information = np.linalg.inv(posterior.covariances)
    pairs = np.indices((len(posterior.means), len(poses)))
    offset = posterior.means[pairs[0]].between(poses[pairs[1]]).log()
    return np.einsum("kji,kil,kjl->kj", offset, information, offset)


def verified(
    posterior: PosePosterior,
    found: Sequence[VerifiedPose],
    settings: Verification,
    mapped: MappedViews | None = None,
) -> PosePosterior:
    """The posterior with the verified places, if any.

    An image that verifies a place is of this map, and so not out of distribution. `mapped` states where landmarks can
    verify places; None for everywhere.
    """
    of_verified = posterior.noise.verified
    if not found or of_verified is None:
        return posterior
    means = Poses.stack([each.world_from_camera for each in found])
    covariances = of_verified.covariance(np.stack([each.covariance for each in found]))
    inliers = np.array([float(each.inliers) for each in found])
    scores = settings.scores(inliers, proposed_weights(posterior, means))
    total = posterior.weights.sum() + scores.sum() + settings.clutter
    return replace(
        posterior,
        means=Poses.concatenate([means, posterior.means]),
        covariances=np.concatenate([covariances, posterior.covariances]),
        weights=np.concatenate([scores, posterior.weights]) / total,
        verified=np.arange(len(found) + len(posterior.weights)) < len(found),
        prior=None,
        ood_score=min(posterior.ood_score, OUT_OF_DISTRIBUTION),
        mapped=mapped,
    )


@dataclass(frozen=True)
class Landmarks:
    """A map of landmarks with the weights of verified places."""

    map: LandmarkMap
    verification: Verification = field(default_factory=Verification)

    @cached_property
    def mapped(self) -> MappedViews:
        """The views where it can verify places."""
        return self.map.mapped(self.verification.reach, self.verification.elsewhere)


class LandmarkVerifier:
    """Adds verified places to the posteriors of any network.

    Args:
        landmarks: A model's, see `ModelDescription.landmarks`.
        noise: Of verified places, the model's `calibration.errors.verified`.

    Attributes:
        latest: Verified poses of the latest image, by decreasing number of landmarks.

    Example:
        >>> import vapor
        >>> model = vapor.VaporObservationModel.from_checkpoint("room.safetensors")  # a model with a map of landmarks
        >>> frame = next(iter(vapor.ImageSequence("room/")))
        >>> near = vapor.Poses.from_quat_xyzw([[0.0, 0.0, 0.0]], [[0, 0, 0, 1]])
        >>> coarse = vapor.PosePosterior.from_estimates(near, std_m=0.5, std_rad=0.2, noise=vapor.MeasurementNoise())
        >>> sharp = model.verifier.verify(frame.image, frame.camera, coarse)
        >>> sharp.has_verified
        True
    """

    def __init__(self, landmarks: Landmarks, noise: MeasurementNoise) -> None:
        self.landmarks = landmarks
        self.latest: list[VerifiedPose] = []
        self._noise, self._localizer = noise, LandmarkLocalizer(landmarks.map)
        pinhole = landmarks.map.camera.camera
        self._as_found = AsTakenBy(pinhole, (pinhole.width, pinhole.height))

    def _view(self, image: Rgb, camera: Camera | None) -> tuple[UInt8[np.ndarray, "h2 w2 3"], bool]:
        """The image, resampled if of another camera than the map's, and whether the lens distorts it."""
        stated = self.landmarks.map.stated
        if camera is None or (stated is not None and same_view(camera, stated)):
            return image, True
        return self._as_found(image, camera), False

    def _features(self, image: Rgb, camera: Camera | None) -> Features:
        view, distorted = self._view(image, camera)
        return self._localizer.features(grey_view(view, self.landmarks.map.camera.camera), distorted=distorted)

    def find(self, image: Rgb, camera: Camera | None, posterior: PosePosterior) -> list[VerifiedPose]:
        """Verified poses of an undistorted RGB image, near the places of its posterior and where it looks alike."""
        order = np.argsort(-posterior.weights, kind="stable")
        return self._localizer.localize(self._features(image, camera), posterior.means[order])

    def verify(self, image: Rgb, camera: Camera | None, posterior: PosePosterior) -> PosePosterior:
        """The posterior of an undistorted RGB image with its verified places, and their errors where it has none."""
        self.latest = self.find(image, camera, posterior)
        if posterior.noise.verified is None:
            posterior = replace(posterior, noise=replace(posterior.noise, verified=self._noise))
        return verified(posterior, self.latest, self.landmarks.verification, self.landmarks.mapped)

    def shown(
        self,
        image: Rgb,
        camera: Camera | None,
        found: Sequence[VerifiedPose],
        *,
        which: int = 0,
        number: int = 0,
    ) -> ShownLandmarks:
        """The landmarks of one of the verified poses in an undistorted RGB image."""
        of_map, pose = self.landmarks.map.camera, found[which]
        view, distorted = self._view(image, camera)

        def on_view(undistorted: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 2"]:
            return of_map.pixels(ViewCamera(of_map.camera).rays(undistorted)) if distorted else undistorted

        width, height = of_map.camera.width, of_map.camera.height
        features = self._features(image, camera)
        return ShownLandmarks(
            centre_crop(scale_to_cover(view, width, height), width, height).copy(),
            on_view(features.pixels),
            on_view(self._localizer.disagreeing(features, pose.world_from_camera)),
            on_view(pose.pixels),
            on_view(pose.pixels + pose.residuals),
            tuple(each.inliers for i, each in enumerate(found) if i != which),
            number,
        )


def grey_view(image: Rgb, camera: Camera) -> UInt8[np.ndarray, "height width"]:
    """The middle of an RGB image, grey, of a camera's size."""
    grey = np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY))
    covering = scale_to_cover(grey, camera.width, camera.height)
    return np.ascontiguousarray(centre_crop(covering, camera.width, camera.height))
