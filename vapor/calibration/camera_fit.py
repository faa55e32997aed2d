"""The camera that fits images and their true poses, beside the one that is stated of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Int64

from filtering.se3 import Poses
from vapor.calibration.verified_errors import QueryFeatures, leave_out
from vapor.landmarks.build import BuiltMap, Material, build, camera_found
from vapor.landmarks.view_camera import ViewCamera

_COMPARED = 60  # images by which two cameras are compared
_CLEARLY = 0.95  # times the error, with which another camera fits clearly better

_GRID = 12  # points along either axis, by which it is measured how far apart cameras are


@dataclass(frozen=True)
class CameraFit:
    """A camera that was found, and how much better it fits than the stated one.

    Attributes:
        stated: What is stated, or guessed where nothing is, at the size at which features are found.
        known: Whether it is stated.
        found: What fits, at that size.
        focal_std: Of the logarithm of its focal length, standard deviation, as far as pixels tell.
        by_stated: The map by the stated camera; None where it gives none, or was not asked for.
        by_found: Likewise by the one found.
        errors_m: Median error of images localized without those near them in time, by either map, metres: infinite
            where of most images no pose of the right place is verified; None where there is one map only.
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
        """Whether the camera found fits clearly better."""
        if self.by_found is None:
            return False
        return self.errors_m is None or self.errors_m[1] < _CLEARLY * self.errors_m[0]

    @property
    def apart_px(self) -> float:
        """How far apart both see the same rays, median over the image, pixels at the size of `stated`."""
        own = self.stated.camera
        grid = np.meshgrid(np.linspace(0.0, own.width - 1.0, _GRID), np.linspace(0.0, own.height - 1.0, _GRID))
        pixels = np.stack(grid, axis=-1).reshape(-1, 2)
        return float(np.median(np.linalg.norm(self.found.pixels(self.stated.rays(pixels)) - pixels, axis=1)))

    def said(self, width: int) -> str:
        """Both cameras in words.

        Args:
            width: Of the images, pixels, in which focal lengths are said.
        """
        stated_px, fits_px = (width / each.camera.width * each.camera.fx for each in (self.stated, self.found))
        before = f"{stated_px:.0f} px stated" if self.known else "no focal length is stated"
        if self.by_found is None:
            return f"{before}, and no other fits better"
        fit = "fit the images" if self.is_better else "fit the images no better"
        said = f"{before}, {fits_px:.0f} px and distortion k1 {self.found.k1:.3f}, k2 {self.found.k2:.3f} {fit}"
        if self.errors_m is None or self.by_stated is None:
            return said
        said += f": {self.by_found.agreeing:.0%} instead of {self.by_stated.agreeing:.0%} of matches agree"
        if not np.isfinite(self.errors_m).any():
            return said
        stated, found = (f"{100 * each:.1f} cm" if np.isfinite(each) else "" for each in self.errors_m)
        return (
            f"{said}, and images are localized {f'within {found}' if found else 'hardly at all'} instead of"
            f" {stated or 'hardly at all'}"
        )


def fit_camera(
    material: Material, stated: ViewCamera, error_m: Callable[[BuiltMap], float], *, known: bool, compare: bool = True
) -> CameraFit | None:
    """The camera that fits; None where too few points are seen from two sides to tell.

    Args:
        material: Key images and their features.
        stated: The camera to start from.
        error_m: Gives the median error of images localized by a map, see `typical_error_m`.
        known: Whether it is stated, or a guess.
        compare: Whether to find how much better another camera fits, where one is stated.
    """
    found = camera_found(material, stated)
    if found is None:
        return None
    by_found, by_stated = build(material, found.camera), build(material, stated) if known and compare else None
    errors = None if by_stated is None or by_found is None else (error_m(by_stated), error_m(by_found))
    return CameraFit(stated, known, found.camera, found.focal_std, by_stated, by_found, errors)


def typical_error_m(built: BuiltMap, features: QueryFeatures, poses: Poses, sequence: Int64[np.ndarray, " n"]) -> float:
    """Median error of images localized without those near them in time; see `leave_out` for the arguments.

    Infinite where of most images no pose of the right place is verified.
    """
    left_out = leave_out(built, features, poses, sequence, most=_COMPARED, stretches=(1.0,))
    metres, _ = left_out.errors
    every = np.concatenate([metres, np.full(len(left_out.image) - len(metres), np.inf)])
    return float(np.median(every)) if len(every) else np.inf
