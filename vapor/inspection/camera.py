"""The stated intrinsics, and those that fit images and their true poses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import IO, Any

import numpy as np

from sequences.datasets.frames import PosedFrames
from sequences.errors import SequenceError
from sequences.frame import Camera, Frame
from sequences.options import SequenceOptions
from vapor.calibration.camera_fit import CameraFit, fit_camera, material_of
from vapor.training_data.entries import open_sequences
from vapor.training_data.load import GreyViews, commonest_camera, usual_camera
from vapor.training_data.training_set import TrainingSet

_SAME_PX = 1.0  # median distance, at the size at which features are found: nearer is as stated


def usual_of(data: Sequence[Path | str], reading: SequenceOptions | None) -> Camera | None:
    """The camera of most images of data of one camera, as `train` has it; None of several, and where it is unknown."""
    sequences = open_sequences(data, reading, "unread")
    with suppress(SequenceError):  # without true poses, or said when it is read
        camera = commonest_camera(sequences)
        names = {
            name for frames in sequences.values() if isinstance(frames, PosedFrames) for name in frames.camera_names
        }
        return camera if len(names) < 2 else None
    return None


class CameraViews:
    """The images of one camera that have a true pose, grey and small, in a file.

    Images of other intrinsics are resampled, as for a training, to those of `usual`, or else of the first image.
    """

    def __init__(self, usual: Camera | None, file: IO[bytes]) -> None:
        self._file = file
        self._views: GreyViews | None = None
        self._camera = usual
        self._is_stated = usual is not None
        self._rows: list[int] = []

    def take(self, frame: Frame, row: int) -> None:
        """The next image with a true pose; its row in the `TrainingSet` that will be checked."""
        if not frame.image.size:
            return
        if self._camera is None:
            height, width = frame.image.shape[:2]
            self._is_stated = frame.camera is not None
            self._camera = usual_camera(width, height) if frame.camera is None else frame.camera
        if self._views is None:
            self._views = GreyViews(self._camera, self._file)
        self._views.take(frame)
        self._rows.append(row)

    def check(
        self, images: TrainingSet | None, advance: Callable[[int, int], None] = lambda done, total: None
    ) -> CameraCheck:
        """Fit the camera as a training does; `advance` is called with the number of key images done and of all.

        `images` have the poses of all images; None where no image has one.
        """
        if self._views is None or self._camera is None or images is None:
            return CameraCheck(0, None, None, False)
        count, fit = len(self._rows), None
        if count > 1:
            own = images.select(np.array(self._rows))
            own = replace(own, rows=np.arange(count), views=self._views.kept(), view_camera=self._views.camera)
            own = replace(own, camera=self._camera if self._is_stated else None, seen_points=_some(images, self._rows))
            material = material_of(own, advance)
            fit = None if material is None else fit_camera(material)
        if fit is not None and fit.by_stated is None and fit.by_found is None:
            fit = None
        return CameraCheck(count, self._camera, fit, not self._views.others)


def _some(images: TrainingSet, rows: list[int]) -> tuple[Any, ...]:
    return tuple(images.seen_points[row] for row in rows) if images.seen_points else ()


@dataclass(frozen=True)
class CameraCheck:
    """The stated intrinsics, and those that fit a number of images and their true poses.

    The camera is as stated, at the size of the images, or a guess; None without true poses. There is no fit where too
    little is seen from two sides. `of_all`: whether no image was resampled, for its other intrinsics.
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
