"""The stated intrinsics, and those that fit images and their true poses."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import UInt8

from filtering.se3 import Poses
from sequences.frame import Camera, Frame
from vapor.calibration.camera_fit import CameraFit, fit_camera
from vapor.landmarks.build import gather
from vapor.landmarks.verify import grey_view
from vapor.training_data.ground import near_scale_m
from vapor.training_data.load import shrunk, usual_camera

_RUN, _MOST_IMAGES = 30, 300  # images in a row, and in all
_SAME_PX = 1.0  # median distance, at the size at which features are found: nearer is as stated


class _View(NamedTuple):
    number: int  # among the images with a true pose
    grey: UInt8[np.ndarray, "h w"]
    pose: Poses
    camera: Camera  # at the size of the image
    is_stated: bool


class CameraViews:
    """Runs of images with true poses, spread over a recording of unknown length: 300 images at most."""

    def __init__(self) -> None:
        self._views: list[_View] = []
        self._count, self._every = 0, 1

    def take(self, frame: Frame) -> None:
        """The next image."""
        if frame.world_from_camera is None or not frame.image.size:
            return
        number, self._count = self._count, self._count + 1
        if not self._is_kept(number):
            return
        height, width = frame.image.shape[:2]
        camera = usual_camera(width, height) if frame.camera is None else frame.camera
        grey = grey_view(frame.image, shrunk(camera))
        self._views.append(_View(number, grey, frame.world_from_camera, camera, frame.camera is not None))
        while len(self._views) > _MOST_IMAGES:
            self._every *= 2
            self._views = [view for view in self._views if self._is_kept(view.number)]

    def _is_kept(self, number: int) -> bool:
        return number // _RUN % self._every == 0

    def check(self, advance: Callable[[int, int], None] = lambda done, total: None) -> CameraCheck:
        """Fit the camera of most images; `advance` is called with the number of key images done and of all."""
        cameras = Counter((view.camera, view.is_stated) for view in self._views)
        if not cameras:
            return CameraCheck(0, None, None, False)
        (camera, is_stated), count = cameras.most_common(1)[0]
        views = [view for view in self._views if (view.camera, view.is_stated) == (camera, is_stated)]
        fit = _fit(views, advance) if count > 1 else None
        return CameraCheck(count, camera, fit, len(cameras) == 1)


def _fit(views: Sequence[_View], advance: Callable[[int, int], None]) -> CameraFit | None:
    """The camera that fits images of one camera; None where they show too little from two sides."""
    poses = Poses.stack([view.pose for view in views])
    material = gather(
        lambda image: views[image].grey,
        poses,
        shrunk(views[0].camera),
        sequence=np.cumsum(np.diff([view.number for view in views], prepend=-1) > 1),
        stated=views[0].is_stated,
        scale_m=near_scale_m(poses),
        advance=advance,
    )
    fit = None if material is None else fit_camera(material)
    return None if fit is None or (fit.by_stated is None and fit.by_found is None) else fit


@dataclass(frozen=True)
class CameraCheck:
    """The stated intrinsics, and those that fit a number of images and their true poses.

    The camera is as stated, at the size of the images, or a guess; None without true poses. There is no fit where too
    little is seen from two sides. `of_all`: whether all images are of this camera.
    """

    images: int
    camera: Camera | None
    fit: CameraFit | None
    of_all: bool

    @property
    def disagrees(self) -> bool:
        """Whether clearly different intrinsics fit clearly better than the stated ones."""
        return self.fit is not None and self.fit.known and self.fit.is_better and self.fit.apart_px > _SAME_PX

    @property
    def in_words(self) -> str:
        """The finding, in a sentence without its end."""
        if self.fit is None or self.camera is None:
            return f"unknown: {self._why}"
        return self.fit.in_words(self.camera.width)

    @property
    def found(self) -> Camera | None:
        """The pinhole camera that fits, at the size of the images; None where unknown, or none fits."""
        if self.fit is None or self.fit.by_found is None or self.camera is None:
            return None
        return self.fit.found.camera.scaled(self.camera.width, self.camera.height)

    @property
    def _why(self) -> str:
        if self.images < 2:
            return f"{'one image has' if self.images else 'no image has'} a true pose"
        return "too few points are seen from two sides, and where the true poses put them"

    def as_json(self) -> dict[str, Any]:
        """Figures for the report."""
        fit, found = self.fit, self.found
        if fit is None or self.camera is None:
            return {"images": self.images, "unknown": self._why}
        errors = (None, None) if fit.errors_m is None else fit.errors_m
        maps = {"stated": fit.by_stated, "fits": fit.by_found}
        return {
            "images": self.images,
            "stated": asdict(self.camera) if fit.known else None,
            "fits": None if found is None else asdict(found) | {"k1": fit.found.k1, "k2": fit.found.k2},
            "focal_std": fit.focal_std,
            "median_distance_px": fit.apart_px * self.camera.width / fit.stated.camera.width if fit.known else None,
            "fits_clearly_better": fit.is_better,
            "matches_that_agree": {name: None if each is None else each.agreeing for name, each in maps.items()},
            "localization_error_m": {
                name: float(error) if error is not None and np.isfinite(error) else None
                for name, error in zip(maps, errors, strict=True)
            },
        }
