"""The landmarks of a new model: the camera that took its images, the map, and how poses err that it verifies."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np

from filtering.se3 import Poses
from vapor.calibration.camera_fit import fit_camera
from vapor.calibration.image_errors import LEAST_IMAGES
from vapor.calibration.verification import fit_reach
from vapor.calibration.verified_errors import QueryFeatures, VerifiedErrors, fit_verified_errors, leave_out
from vapor.checkpoints.scene_scale import flat_log_density
from vapor.landmarks.build import BuiltMap, Material, build, gather
from vapor.landmarks.landmark_map import ViewCamera
from vapor.landmarks.localize import LandmarkLocalizer, query_features
from vapor.landmarks.verify import Verification
from vapor.training.config import CameraChoice
from vapor.training_data.ground import near_scale_m
from vapor.training_data.training_set import TrainingSet

Advance = Callable[[int, int], None]


@dataclass(frozen=True)
class FoundLandmarks:
    """A map of landmarks, and what is known of it.

    Attributes:
        built: The map of all images that are learned from.
        verified: How poses err that it verifies.
        verification: What is known so far of what it says of a place: where it can verify any.
        images: The images that it is of.
        notes: What was found, in sentences.
    """

    built: BuiltMap
    verified: VerifiedErrors
    verification: Verification
    images: TrainingSet
    notes: tuple[str, ...]

    def without(self, trained: TrainingSet) -> tuple[LandmarkLocalizer, Poses]:
        """What localizes by the images that a network was trained on, and the poses of the key images it lacks."""
        material = self.built.material
        hidden = np.zeros(len(material.key), bool)
        if self.images.images is trained.images:
            hidden = ~np.isin(self.images.rows, trained.rows)[material.key]
        landmarks = self.built.hiding(hidden) if hidden.any() else self.built.landmarks
        return LandmarkLocalizer(landmarks), material.poses[np.flatnonzero(hidden)]


def find_landmarks(
    images: TrainingSet, choice: CameraChoice, advance: Advance = lambda done, total: None
) -> tuple[FoundLandmarks | None, tuple[str, ...]]:
    """Landmarks of training images, None where these do not show any; and what to say of that.

    Args:
        images: All images to learn from, with views.
        choice: Whether the camera is the stated one, the one that fits the images, or which fits clearly better.
        advance: Called with the number of images done and of all, stage by stage.
    """
    if images.view_camera is None or not len(images.views):
        return None, ()
    stated, poses, known = ViewCamera(images.view_camera), images.poses, images.camera is not None
    material = gather(
        lambda image: images.views[images.rows[image]],
        poses,
        stated.camera,
        stated=known,
        scale_m=near_scale_m(poses),
        given=lambda image: images.seen_points[images.rows[image]] if images.seen_points else None,
        advance=advance,
    )
    if material is None:
        return None, (_NONE.format("no two images show the same from two sides"),)
    features = cache(lambda image: query_features(images.views[images.rows[image]]))
    built, notes = _best_map(images, features, material, stated, choice if known else "estimated", known=known)
    if built is None:
        return None, (*notes, _NONE.format("hardly any point is seen where the poses say that it must be"))
    left_out = leave_out(built, features, images.poses, images.sequence, advance=advance)
    verified = fit_verified_errors(left_out, poses, images.sequence, flat_log_density(poses))
    if verified is None:
        few = f"without what was taken near them in time they verify the poses of {len(left_out.right)} images only"
        return None, (*notes, _NONE.format(f"{few}, and how poses err is found on {LEAST_IMAGES} or more"))
    found = (
        f"landmarks: {len(built.points)} points, seen in {len(material.key)} images; without what was taken near them"
        f" in time they verify the poses of {left_out.verified:.0%} of {len(left_out.image)} images, which then err by"
        f" {100 * verified.median_m:.1f} cm and {np.degrees(verified.median_rad):.1f}° (median)"
    )
    if verified.elsewhere > 0.0:
        found += (
            f"; of {verified.elsewhere:.1%} of the images another place, which looks alike, shows the most landmarks"
        )
    verification = fit_reach(left_out, verified.effective_images)
    found += (
        f"; they reach views that differ by {verification.reach * built.material.depth_m:.1f} m, and beyond"
        f" {verification.elsewhere:.0%} are taken for another place"
    )
    return FoundLandmarks(built, verified, verification, images, (*notes, found)), (*notes, found)


_NONE = "no landmarks: {}; places stay as coarse as the network says"


def _best_map(
    images: TrainingSet,
    features: QueryFeatures,
    material: Material,
    stated: ViewCamera,
    choice: CameraChoice,
    *,
    known: bool,
) -> tuple[BuiltMap | None, tuple[str, ...]]:
    """The map by the camera that fits, and what was found of it."""
    if choice == "stated":
        return build(material, stated), ()
    fit = fit_camera(material, stated, features, images.poses, images.sequence, known=known, compare=choice == "auto")
    if fit is None:
        return build(material, stated), ()
    if fit.by_found is None or (choice == "auto" and not fit.is_better):
        return fit.by_stated, ()
    taken = "" if choice == "estimated" or not known else "; so it is taken (--camera stated: the stated one)"
    said = fit.in_words(images.camera_size[0] if images.camera_size else stated.camera.width)
    return fit.by_found, (f"camera: {said}{taken}",)
