"""One recording as it is inspected: a few numbers for each image."""

from __future__ import annotations

import zlib
from collections import Counter
from dataclasses import asdict
from functools import cached_property
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from jaxtyping import Bool, Float64, Int64, UInt8

from filtering.motion import Odometry
from filtering.se3 import Poses
from sequences.datasets.points import SeenPoints
from sequences.frame import Frame
from vapor.training_data.checks import Colours
from vapor.training_data.views import ViewCheck, Views

if TYPE_CHECKING:
    from vapor.inspection.reading import Source

_SIDE_PX = 240  # shorter side at which images are measured
_MUCH_BLURRIER, _DULLER = 0.3, 0.7  # than the recording's median: variance, and variance over that of coarse detail
_DARK, _BRIGHT = 25, 250  # of 255
_NEARLY_ALL, _MUCH = 0.9, 0.4  # of the pixels
_JUMP = 0.5  # of log2 of the mean brightness
_GAP_STEPS, _GAP_S = 3.0, 0.25  # a gap is longer than this many median steps, and than this
_LEAST_RUN = 3  # equal images in a row

_LOOK = np.dtype([(name, "f8") for name in ("sharpness", "coarse", "brightness", "dark", "bright", "digest")])


def look_at(image: UInt8[np.ndarray, "h w 3"]) -> tuple[float, ...]:
    """Figures of one RGB image, in the order of `_LOOK`.

    Sharpness is the variance of the Laplacian of the grey image, scaled to a shorter side of 240 pixels; `coarse` is
    the same at a quarter of that size, where blur takes less of it. Brightness is the mean of the grey image, 0 to 255;
    `dark` and `bright` are the fractions of its pixels below 25 and from 250 on. The digest is a checksum of all bytes.
    """
    scale = _SIDE_PX / min(image.shape[:2])
    size = max(1, round(image.shape[1] * scale)), max(1, round(image.shape[0] * scale))
    method = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    grey = cv2.cvtColor(np.asarray(cv2.resize(image, size, interpolation=method)), cv2.COLOR_RGB2GRAY)
    coarse = cv2.resize(grey, (max(size[0] // 4, 1), max(size[1] // 4, 1)), interpolation=cv2.INTER_AREA)
    return (
        float(cv2.Laplacian(grey, cv2.CV_32F).var()),
        float(cv2.Laplacian(coarse, cv2.CV_32F).var()),
        float(grey.mean()),
        float((grey < _DARK).mean()),
        float((grey >= _BRIGHT).mean()),
        float(zlib.crc32(np.ascontiguousarray(image).data)),
    )


class Walk:
    """One recording of n images, at least one, without its pixels. Read figures once all frames were taken.

    Attributes:
        source: The entry that the recording is from.
        sizes: Number of images by width and height, pixels.
        odometry: Motion since the image before, (n,); None where unknown.
        views: Pairs of images that show the same, spread over the recording.
    """

    def __init__(self, name: str, source: Source) -> None:
        self.name, self.source = name, source
        self.sizes: Counter[tuple[int, int]] = Counter()
        self.odometry: list[Odometry | None] = []
        self.views, self.colours = Views(), Colours()
        self._times_ns: list[int] = []
        self._numbers: list[int] = []
        self._looks: list[tuple[float, ...]] = []
        self._poses: list[Poses | None] = []
        self._points: list[SeenPoints | None] = []

    def take(self, frame: Frame, points: SeenPoints | None = None) -> None:
        """The next image, and the points of a reconstruction that it shows."""
        self.sizes[frame.image.shape[1], frame.image.shape[0]] += 1
        self.odometry.append(frame.odometry)
        self.views.take(frame)
        self.colours.take(frame.image)
        self._numbers.append(len(self) if frame.number is None else frame.number)
        self._times_ns.append(frame.time_ns)
        self._looks.append(look_at(frame.image))
        self._poses.append(frame.world_from_camera)
        self._points.append(points)

    def __len__(self) -> int:
        return len(self._times_ns)

    @cached_property
    def times_ns(self) -> Int64[np.ndarray, " n"]:
        """Stamps of the images."""
        return np.array(self._times_ns, np.int64)

    @cached_property
    def numbers(self) -> Int64[np.ndarray, " n"]:
        """Numbers of the images in the file or folder, as PATH@START:STOP counts."""
        return np.array(self._numbers, np.int64)

    @property
    def seconds(self) -> Float64[np.ndarray, " n"]:
        """Seconds since the first image."""
        return (self.times_ns - self.times_ns[0]) * 1e-9

    @cached_property
    def posed(self) -> Bool[np.ndarray, " n"]:
        """Which images have a true pose."""
        return np.array([pose is not None for pose in self._poses])

    @cached_property
    def poses(self) -> Poses:
        """The k true poses, world_from_camera."""
        known = [pose for pose in self._poses if pose is not None]
        return Poses.stack(known) if known else Poses.identity(0)

    @property
    def seen_points(self) -> list[SeenPoints | None]:
        """Points of a reconstruction that each of the k images with a true pose shows."""
        return [each for each, posed in zip(self._points, self.posed, strict=True) if posed]

    @cached_property
    def checks(self) -> list[ViewCheck]:
        """The motion that images show, compared with true poses and odometry."""
        return self.views.checks()

    @cached_property
    def looks(self) -> np.ndarray:
        """Figures of the images, (n,), with the fields of `_LOOK`."""
        return np.array(self._looks, _LOOK)

    @property
    def blurred(self) -> Bool[np.ndarray, " n"]:
        """Which images are much blurrier than the recording's median, and not for lack of texture."""
        looks = self.looks
        fine = looks["sharpness"] / np.maximum(looks["coarse"], 1e-6)
        is_blurry = looks["sharpness"] < _MUCH_BLURRIER * np.median(looks["sharpness"])
        return is_blurry & (fine < _DULLER * np.median(fine)) & ~self.dark

    @property
    def dark(self) -> Bool[np.ndarray, " n"]:
        """Which images are nearly black."""
        return self.looks["dark"] >= _NEARLY_ALL

    @property
    def blown(self) -> Bool[np.ndarray, " n"]:
        """Which images are blown out in a large part."""
        return self.looks["bright"] >= _MUCH

    @property
    def jumps(self) -> Bool[np.ndarray, " n"]:
        """Which images are half a stop brighter or darker than the one before."""
        stops = np.log2(self.looks["brightness"] + 1.0)
        return np.abs(np.diff(stops, prepend=stops[:1])) > _JUMP

    @property
    def repeated(self) -> Bool[np.ndarray, " n"]:
        """Which images equal the one before, to the last bit."""
        digests = self.looks["digest"]
        return np.diff(digests, prepend=digests[:1] - 1) == 0

    @property
    def gaps(self) -> list[tuple[float, float]]:
        """Long gaps between images: seconds since the first image, and duration, from the longest down."""
        if self.source.assumed_hz is not None or len(self) < 3:
            return []
        steps = np.diff(self.seconds)
        long = np.flatnonzero(steps > max(_GAP_STEPS * float(np.median(steps)), _GAP_S))
        found = [(float(self.seconds[i]), float(steps[i])) for i in long]
        return sorted(found, key=lambda gap: -gap[1])

    @property
    def frozen(self) -> list[tuple[int, int]]:
        """Numbers of the first and last of at least three images in a row that are equal."""
        begins = np.flatnonzero(~self.repeated)
        lengths = np.diff([*begins.tolist(), len(self)])
        long = lengths >= _LEAST_RUN
        first, last = self.numbers[begins[long]], self.numbers[begins[long] + lengths[long] - 1]
        return list(zip(first.tolist(), last.tolist(), strict=True))

    @property
    def path_m(self) -> float | None:
        """Length of the path by true poses or else by odometry; None without either."""
        if len(self.poses):
            return float(np.linalg.norm(np.diff(self.poses.translation, axis=0), axis=1).sum())
        moved = [np.linalg.norm(step.previous_from_current.translation) for step in self.odometry if step is not None]
        return float(np.sum(moved)) if moved else None

    @property
    def speed_m_per_s(self) -> float | None:
        """Median speed of the camera by true poses; None where unknown."""
        if len(self.poses) < 2 or self.source.assumed_hz is not None:
            return None
        seconds = np.maximum(np.diff(self.seconds[self.posed]), 1e-9)
        return float(np.median(np.linalg.norm(np.diff(self.poses.translation, axis=0), axis=1) / seconds))

    def as_json(self) -> dict[str, Any]:
        """Figures for the report."""
        steps, source = np.diff(self.seconds), self.source
        return {
            "name": self.name,
            "images": len(self),
            "images_with_true_pose": int(self.posed.sum()),
            "images_with_odometry": sum(step is not None for step in self.odometry),
            "duration_s": float(self.seconds[-1]),
            "rate_hz": float(1.0 / np.median(steps)) if len(steps) and source.assumed_hz is None else None,
            "sizes": {f"{w} x {h}": count for (w, h), count in self.sizes.items()},
            "path_m": self.path_m,
            "sharpness": float(np.median(self.looks["sharpness"])),
            "brightness": float(np.median(self.looks["brightness"])),
            "blurred": float(self.blurred.mean()),
            "dark": float(self.dark.mean()),
            "blown_out": float(self.blown.mean()),
            "brightness_jumps": self.numbers[self.jumps].tolist(),
            "frozen_images": [list(run) for run in self.frozen],
            "gaps": [{"at_s": at_s, "seconds": long_s} for at_s, long_s in self.gaps],
            "counts": None if source.counts is None else source.counts.as_json(),
            "skipped": dict(source.skipped),
            "notices": list(source.notices),
            "lacks": dict(source.lacks),
            "views": [asdict(check) for check in self.checks],
        }
