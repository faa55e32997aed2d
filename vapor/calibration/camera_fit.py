"""The camera that fits images and their true poses, beside the one that is stated of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vapor.calibration.verified_errors import leave_out
from vapor.landmarks.build import Advance, BuiltMap, Material, build, camera_found, gather
from vapor.landmarks.landmark_map import ViewCamera
from vapor.training_data.ground import near_scale_m
from vapor.training_data.training_set import TrainingSet

_COMPARED = 60  # images by which two cameras are compared
_CLEARLY = 0.95  # times the error, with which another camera fits clearly better

_GRID = 12  # points along either axis, by which it is measured how far apart cameras are


@dataclass(frozen=True)
class CameraFit:
    """A camera that was found, beside the stated one.

    Attributes:
        stated: The stated or guessed camera, at the size of the features.
        known: Whether the camera is stated.
        found: The camera of best fit, at that size.
        focal_std: Standard deviation of the logarithm of the found focal length, from pixels alone.
        by_stated: The map by the stated camera, if it was built.
        by_found: The map by the found camera, if it could be built.
        errors_m: Median errors of localized images by both maps, infinite where most have no right pose; None where
            there is only one map.
    """

    stated: ViewCamera
    known: bool
    found: ViewCamera
    focal_std: float
    by_stated: BuiltMap | None
    by_found: BuiltMap | None
    errors_m: tuple[float, float] | None

    @property
    def is_better(self) -> bool:
        """Whether the found camera fits clearly better."""
        if self.by_found is None:
            return False
        return self.errors_m is None or self.errors_m[1] < _CLEARLY * self.errors_m[0]

    @property
    def apart_px(self) -> float:
        """Median distance between both cameras' pixels of the same rays, pixels at the size of `stated`."""
        own = self.stated.camera
        grid = np.meshgrid(np.linspace(0.0, own.width - 1.0, _GRID), np.linspace(0.0, own.height - 1.0, _GRID))
        pixels = np.stack(grid, axis=-1).reshape(-1, 2)
        return float(np.median(np.linalg.norm(self.found.pixels(self.stated.rays(pixels)) - pixels, axis=1)))

    def in_words(self, width: int) -> str:
        """Both cameras in words, with focal lengths for images of this width in pixels."""
        stated_px, found_px = (width / each.camera.width * each.camera.fx for each in (self.stated, self.found))
        words = f"{stated_px:.0f} px stated" if self.known else "no focal length is stated"
        if self.by_found is None:
            return f"{words}, and no other fits better"
        fit = "fit the images" if self.is_better else "fit the images no better"
        words += f", {found_px:.0f} px and distortion k1 {self.found.k1:.3f}, k2 {self.found.k2:.3f} {fit}"
        if self.errors_m is None or self.by_stated is None:
            return words
        stated, found = (f"{100 * each:.1f} cm" if np.isfinite(each) else "hardly at all" for each in self.errors_m)
        agree, instead = f"{self.by_found.agreeing:.0%}", f"{self.by_stated.agreeing:.0%}"
        agree += " of matches agree either way" if agree == instead else f" instead of {instead} of matches agree"
        within = f"within {found} " + ("either way" if found == stated else f"instead of {stated}")
        return f"{words}: {agree}, and images are localized {within}"


def material_of(images: TrainingSet, advance: Advance | None = None) -> Material | None:
    """What a map and a camera are found from, of images with views; None where no two show the same from two sides.

    `advance` is called with the number of key images done, and of all.
    """
    assert images.view_camera is not None
    return gather(
        lambda image: images.views[images.rows[image]],
        images.poses,
        images.view_camera,
        sequence=images.sequence,
        stated=images.camera is not None,
        scale_m=near_scale_m(images.poses),
        given=lambda image: images.seen_points[images.rows[image]] if images.seen_points else None,
        advance=advance,
    )


def fit_camera(material: Material, *, compare: bool = True) -> CameraFit | None:
    """The camera of best fit; None where too few points are seen from two sides.

    Where a camera is stated, the maps by both cameras are compared by localized images, if `compare`.
    """
    stated, known = ViewCamera(material.camera), material.stated is not None
    found = camera_found(material, stated)
    if found is None:
        return None
    by_found, by_stated = build(material, found.camera), build(material, stated) if known and compare else None
    errors = None
    if by_stated is not None and by_found is not None:
        errors = _typical_error_m(by_stated), _typical_error_m(by_found)
    return CameraFit(stated, known, found.camera, found.focal_std, by_stated, by_found, errors)


def _typical_error_m(built: BuiltMap) -> float:
    """Median error of localized images; infinite where most have no verified pose of the right place."""
    left_out = leave_out(built, most=_COMPARED, stretches=(1.0,))
    metres, _ = left_out.errors
    every = np.concatenate([metres, np.full(len(left_out.found) - len(metres), np.inf)])
    return float(np.median(every)) if len(every) else np.inf
