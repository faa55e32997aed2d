"""The landmarks of a new model: the camera that took its images, the map, and how poses err that it verifies."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np

from filtering.se3 import Poses
from vapor.calibration.image_errors import LEAST_IMAGES
from vapor.calibration.verification import fit_reach
from vapor.calibration.verified_errors import QueryFeatures, VerifiedErrors, fit_verified_errors, leave_out
from vapor.checkpoints.scene_scale import flat_log_density
from vapor.landmarks.build import BuiltMap, Material, build, camera_found, gather
from vapor.landmarks.localize import LandmarkLocalizer, query_features
from vapor.landmarks.verify import Verification
from vapor.landmarks.view_camera import ViewCamera
from vapor.training.config import CameraChoice
from vapor.training_data.ground import near_scale_m
from vapor.training_data.training_set import TrainingSet

_COMPARED = 60  # images by which two cameras are compared
_CLEARLY = 0.95  # times the error, with which another camera fits clearly better

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
    found = None if choice == "stated" else camera_found(material, stated)
    by_stated = build(material, stated) if choice != "estimated" or found is None else None
    if found is None:
        return by_stated, ()
    by_found = build(material, found.camera)
    width = (images.camera_size[0] if images.camera_size else stated.camera.width) / stated.camera.width
    fits, told = width * found.camera.camera.fx, width * stated.camera.fx
    if by_found is None:
        return by_stated, ()
    if by_stated is None:
        what = f"{told:.0f} px stated, " if known else "no focal length is stated, "
        return by_found, (f"camera: {what}{fits:.0f} px fit the images{_distortion(found.camera)}",)
    errors = [_typical_error_m(images, features, each) for each in (by_stated, by_found)]
    better = errors[1] < _CLEARLY * errors[0]
    if not better:
        return by_stated, ()
    before = f"instead of {100 * errors[0]:.1f} cm" if np.isfinite(errors[0]) else "instead of hardly at all"
    note = (
        f"camera: {told:.0f} px stated, {fits:.0f} px{_distortion(found.camera)} fit the images:"
        f" {by_found.agreeing:.0%} instead of {by_stated.agreeing:.0%} of matches agree, and images are localized"
        f" within {100 * errors[1]:.1f} cm {before}; so it is taken (--camera stated: the"
        " stated one)"
    )
    return by_found, (note,)


def _distortion(camera: ViewCamera) -> str:
    return f" and distortion k1 {camera.k1:.3f}, k2 {camera.k2:.3f}"


def _typical_error_m(images: TrainingSet, features: QueryFeatures, built: BuiltMap) -> float:
    """Median error of left-out images; infinite of those of which no pose of the right place is verified."""
    left_out = leave_out(built, features, images.poses, images.sequence, most=_COMPARED, stretches=(1.0,))
    metres, _ = left_out.errors
    every = np.concatenate([metres, np.full(len(left_out.image) - len(metres), np.inf)])
    return float(np.median(every)) if len(every) else np.inf
