"""The landmarks of a new model: camera, map, errors of verified poses, and verification of held-out images."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Literal

import numpy as np
from jaxtyping import Bool

from filtering.errors import length_said
from filtering.mapped_views import MappedViews
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from filtering.training_prior import TrainingPrior
from vapor.calibration.calibrate import NUM_SAMPLES
from vapor.calibration.camera_fit import fit_camera, material_of
from vapor.calibration.error_correlation import (
    LEAST_IMAGES,
    ErrorCorrelation,
    Travel,
    effective_images,
    outlier_lengths,
)
from vapor.calibration.verification import SeenPlaces, evidence, fit_reach, fit_verification, none_right
from vapor.calibration.verified_errors import VerifiedErrors, fit_verified_errors, leave_out
from vapor.checkpoints.calibration import Calibration
from vapor.checkpoints.scene_scale import log_clutter_density, spaced
from vapor.evaluation.seen_images import describe_images
from vapor.evaluation.validation import predict
from vapor.landmarks.build import BuiltMap, Material, build
from vapor.landmarks.landmark_map import ViewCamera
from vapor.landmarks.localize import LandmarkLocalizer, VerifiedPose
from vapor.landmarks.verify import Verification
from vapor.regressors.base import PoseRegressor
from vapor.regressors.ood_model import OodModel
from vapor.tracking.follow import posterior_of
from vapor.training.config import CameraChoice, TrainConfig
from vapor.training.holding_out import Split
from vapor.training_data.ground import pass_numbers
from vapor.training_data.training_set import TrainingSet

_NONE = "no landmarks: {}; places stay as coarse as the network's"
_IMAGES = 200
_NEAR = 0.25, 0.2  # depths and radians: a verified pose so near to the true one is of the right place
_NONE_RIGHT = 0.05  # where nothing was held out
_NEW_VIEW = 0.5  # depths: a view that differs by less shows the same landmarks
_AROUND = 1.5  # depths or radians: key images further away are ignored


@dataclass(frozen=True)
class FoundLandmarks:
    """A map of landmarks of training images.

    Attributes:
        built: The map.
        verified: Errors of the poses that it verifies.
        verification: The reach of the map, and default weights.
        images: Images of the map.
    """

    built: BuiltMap
    verified: VerifiedErrors
    verification: Verification
    images: TrainingSet

    def without(self, trained: TrainingSet) -> tuple[LandmarkLocalizer, Poses]:
        """A localizer by the images that a network was trained on, and the poses of the key images it lacks."""
        material = self.built.material
        hidden = np.zeros(len(material.key), bool)
        if self.images.images is trained.images:
            hidden = ~np.isin(self.images.rows, trained.rows)[material.key]
        landmarks = self.built.hiding(hidden) if hidden.any() else self.built.landmarks
        return LandmarkLocalizer(landmarks), material.poses[np.flatnonzero(hidden)]


def find_landmarks(
    images: TrainingSet,
    choice: CameraChoice,
    advance: Callable[[Literal["landmarks", "localizing by landmarks"], int, int], None] = lambda stage, done, of: None,
) -> tuple[FoundLandmarks | None, tuple[str, ...]]:
    """Landmarks of training images with views, or None, and findings in sentences.

    `advance` is called with the stage, the number of images done, and of all.
    """
    if images.view_camera is None or not len(images.views):
        return None, ()
    material = material_of(images, partial(advance, "landmarks"))
    if material is None:
        return None, (_NONE.format("no two images show the same from two sides"),)
    built, notes = _best_map(material, choice, images.camera_size[0])
    if built is None:
        return None, (*notes, _NONE.format("hardly any point is seen where it must be by the poses"))
    left_out = leave_out(built, advance=partial(advance, "localizing by landmarks"))
    verified = fit_verified_errors(left_out, log_clutter_density(images.poses))
    if verified is None:
        few = f"without the images taken near them in time they verify the poses of {len(left_out.right)} images only"
        return None, (*notes, _NONE.format(f"{few}, and how poses err is found on {LEAST_IMAGES} or more"))
    found = (
        f"landmarks: {len(built.points)} points, seen in {len(material.key)} images; without the images taken near them"
        f" in time they verify the poses of {left_out.verified:.0%} of {len(left_out.found)} images, which then err by"
        f" {100 * verified.median_m:.1f} cm and {np.degrees(verified.median_rad):.1f}° (median)"
    )
    if verified.elsewhere > 0.0:
        found += (
            f"; of {verified.elsewhere:.1%} of the images another place, which looks alike, shows the most landmarks"
        )
    verification = fit_reach(left_out, verified.effective_images)
    found += (
        f"; an image shows them where its view differs by up to {length_said(verification.reach * material.depth_m)}"
        f" from those of the map; of images further away {verification.elsewhere:.0%} are taken for another place"
    )
    return FoundLandmarks(built, verified, verification, images), (*notes, found)


def _best_map(material: Material, choice: CameraChoice, width_px: int) -> tuple[BuiltMap | None, tuple[str, ...]]:
    """The map by the camera that fits, with a notice on images of this width."""
    choice = choice if material.stated is not None else "estimated"
    fit = None if choice == "stated" else fit_camera(material, compare=choice == "auto")
    if fit is None:
        return build(material, ViewCamera(material.camera)), ()
    if fit.by_found is None or (choice == "auto" and not fit.is_better):
        return fit.by_stated, ()
    taken = "; so it is taken (--camera stated: the stated one)" if choice == "auto" else ""
    return fit.by_found, (f"camera: {fit.in_words(width_px)}{taken}",)


@dataclass(frozen=True)
class HeldOutLandmarks:
    """Verification of held-out images by the landmarks that training images show.

    Attributes:
        localizer: Localizer by the training images.
        hidden: Poses of the key images that the localizer lacks, (h,).
        verification: Weights of verified places.
        none_right: Probability that no verified place of an image is right.
        outlier_lengths: Correlation length of mistakes about verified places, in lengths of their errors.
    """

    localizer: LandmarkLocalizer
    hidden: Poses
    verification: Verification
    none_right: float = _NONE_RIGHT
    outlier_lengths: float = 4.0

    @cached_property
    def mapped(self) -> MappedViews:
        """Region in which the localizer can verify places."""
        return self.localizer.mapped(self.verification.reach, self.verification.elsewhere)

    @staticmethod
    def of(
        landmarks: FoundLandmarks,
        network: PoseRegressor,
        split: Split,
        calibration: Calibration,
        prior_poses: Poses,
        ood_model: OodModel | None,
        config: TrainConfig,
    ) -> HeldOutLandmarks:
        """Fit the reliability of verified places on the held-out images."""
        localizer, hidden = landmarks.without(split.training)
        held = HeldOutLandmarks(localizer, hidden, landmarks.verification)
        rows = np.flatnonzero(split.held_out_mask)
        rows = rows[spaced(len(rows), _IMAGES)]
        if not len(rows):
            return held
        some = split.source.select(rows)
        scores = ood_model.ood_score(describe_images(network, some)) if ood_model else np.zeros(len(rows))
        seen, which, depth_m = [], [], landmarks.built.material.depth_m
        prior = TrainingPrior(prior_poses, calibration.errors.radius_m, calibration.errors.radius_rad)
        for row, samples, score in zip(rows, predict(network, some, NUM_SAMPLES, config.seed), scores, strict=True):
            posterior = posterior_of(samples, calibration.errors, float(score), prior)
            found = held.found(split.source, int(row), posterior)
            if found:
                which.append(int(row))
                truth = split.source.poses[int(row)]
                seen.append(SeenPlaces.of(posterior, found, truth, near_m=_NEAR[0] * depth_m, near_rad=_NEAR[1]))
        if not seen:
            return held
        noise, own = calibration.errors, landmarks.verified.noise
        longer = max(noise.outlier_lengths, 1.0)
        correlation = ErrorCorrelation(1.0, longer * noise.length_m, longer * noise.length_rad)
        travel = Travel.along(split.source.poses, pass_numbers(split.source))[np.array(which)]
        effective = effective_images(travel, correlation)
        verification, wrong = fit_verification(seen, effective, landmarks.verification), none_right(seen, effective)
        weights = evidence(seen, verification, replace(own, outlier_probability=wrong))
        new_view_m = _NEW_VIEW * depth_m  # mistakes last as long as views, not as errors of millimetres
        views = ErrorCorrelation(1.0, new_view_m, _NEW_VIEW)
        mistaken = outlier_lengths(weights, travel, views) * new_view_m / own.length_m
        return replace(held, verification=verification, none_right=wrong, outlier_lengths=mistaken)

    def found(self, images: TrainingSet, row: int, posterior: PosePosterior) -> list[VerifiedPose]:
        """Verified poses of an image with this posterior, as if it were new to the map everywhere.

        Key images are hidden around the true pose. So that similar places have no advantage, their corresponding key
        images are ignored, too.
        """
        if not len(images.views):
            return []
        localizer, truth = self.localizer, images.poses[row]
        proposed = posterior.means[np.argsort(-posterior.weights, kind="stable")]
        features = localizer.features(images.views[images.rows[row]])
        found = localizer.localize(features, proposed)
        ignored = np.zeros(len(localizer.landmarks.poses), bool)
        for each in found:
            ignored |= self._counterparts(each.world_from_camera, truth)
        return localizer.ignoring(ignored).localize(features, proposed) if ignored.any() else found

    def _counterparts(self, found: Poses, truth: Poses) -> Bool[np.ndarray, " n"]:
        """Key images around a pose that correspond to hidden ones around the true pose, unless both poses are near."""
        localizer, depth_m = self.localizer, self.localizer.landmarks.depth_m
        ignored = np.zeros(len(localizer.landmarks.poses), bool)
        metres, radians = map(float, found.distance(truth))
        if not len(self.hidden) or (metres < _NEAR[0] * depth_m and radians < _NEAR[1]):
            return ignored
        around = np.flatnonzero(localizer.view_distances(found) < _AROUND)
        moved = (truth @ found.inverse()) @ localizer.landmarks.poses[around]
        views = (MappedViews(others, depth_m, 1.0, 0.0) for others in (self.hidden, localizer.landmarks.poses))
        apart = [each.distances(moved) for each in views]
        ignored[around] = apart[0] < apart[1]
        return ignored
