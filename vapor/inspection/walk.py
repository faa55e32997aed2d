"""One recording as it is inspected: a few numbers for each image."""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float64, Int64, UInt8

from filtering.motion import Odometry
from filtering.se3 import Poses
from sequences.reading.counts import ImageCounts
from vapor.training_data.colours import Colours
from vapor.training_data.views import Pair, ViewCheck

_SIDE_PX = 240  # shorter side at which images are measured

_MUCH_BLURRIER, _DULLER = 0.3, 0.7  # than the recording's median: variance, and variance over that of coarse detail
_DARK, _BRIGHT = 25, 250  # of 255
_NEARLY_ALL, _MUCH = 0.9, 0.4  # of the pixels
_JUMP = 0.5  # of log2 of the mean brightness


class Look(NamedTuple):
    """Figures of one image.

    Sharpness is the variance of the Laplacian of the grey image, scaled to a shorter side of 240 pixels; `coarse` is
    the same at a quarter of that size, where blur takes less of it. Brightness is the mean of the grey image, 0 to 255;
    `dark` and `bright` are the fractions of its pixels below 25 and from 250 on. The digest is a checksum of all bytes.
    """

    sharpness: float
    coarse: float
    brightness: float
    dark: float
    bright: float
    digest: int
    width: int
    height: int


def look_at(image: UInt8[np.ndarray, "h w 3"]) -> Look:
    """The figures of one RGB image."""
    scale = _SIDE_PX / min(image.shape[:2])
    size = max(1, round(image.shape[1] * scale)), max(1, round(image.shape[0] * scale))
    method = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    grey = cv2.cvtColor(np.asarray(cv2.resize(image, size, interpolation=method)), cv2.COLOR_RGB2GRAY)
    coarse = cv2.resize(grey, (max(size[0] // 4, 1), max(size[1] // 4, 1)), interpolation=cv2.INTER_AREA)
    return Look(
        float(cv2.Laplacian(grey, cv2.CV_32F).var()),
        float(cv2.Laplacian(coarse, cv2.CV_32F).var()),
        float(grey.mean()),
        float((grey < _DARK).mean()),
        float((grey >= _BRIGHT).mean()),
        zlib.crc32(np.ascontiguousarray(image).data),
        image.shape[1],
        image.shape[0],
    )


@dataclass(frozen=True)
class Looks:
    """Figures and flags of the n images of one recording, in order, (n,) each.

    `blurred`: much blurrier than the recording's median, and not for lack of texture. `blown`: with a large part blown
    out. `jumps`: half a stop brighter or darker than the image before. `repeated`: equal to it to the last bit.
    """

    sharpness: Float64[np.ndarray, " n"]
    brightness: Float64[np.ndarray, " n"]
    blurred: Bool[np.ndarray, " n"]
    dark: Bool[np.ndarray, " n"]
    blown: Bool[np.ndarray, " n"]
    jumps: Bool[np.ndarray, " n"]
    repeated: Bool[np.ndarray, " n"]

    @staticmethod
    def of(looks: Sequence[Look]) -> Looks:
        """Compare the images of a recording, at least one."""
        sharpness, coarse, brightness, dark, bright = (
            np.array([look[i] for look in looks], np.float64) for i in range(5)
        )
        fine = sharpness / np.maximum(coarse, 1e-6)
        blurred = sharpness < _MUCH_BLURRIER * np.median(sharpness)
        blurred &= (fine < _DULLER * np.median(fine)) & (dark < _NEARLY_ALL)
        stops = np.log2(brightness + 1.0)
        digests = np.array([look.digest for look in looks], np.int64)
        return Looks(
            sharpness,
            brightness,
            blurred,
            dark >= _NEARLY_ALL,
            bright >= _MUCH,
            np.abs(np.diff(stops, prepend=stops[:1])) > _JUMP,
            np.diff(digests, prepend=digests[:1] - 1) == 0,
        )


_GAP_STEPS, _GAP_S = 3.0, 0.25  # longer than so many usual steps, and than so long
_LEAST_RUN = 3  # images that are one and the same
_RIPE = 50  # images with odometry or poses, to find whether blur comes with turns


@dataclass(frozen=True)
class Walk:
    """One recording of n images, without its pixels.

    Sizes count images by width and height, pixels. Stamps, whether an image has a true pose (`posed`), and the odometry
    since the image before (None where unknown) are (n,), the k true poses (k,), world_from_camera. Counts are None of
    images on disk; `skipped` has images and unreadable messages by reason, `lacks` the reasons why "true poses" or
    "odometry" are missing. A rate is assumed for want of stamps only. `pairs` of images show the same, spread over the
    recording; `views` compare their motion with that of true poses and odometry.
    """

    name: str
    times_ns: Int64[np.ndarray, " n"]
    sizes: Mapping[tuple[int, int], int]
    looks: Looks
    posed: Bool[np.ndarray, " n"]
    poses: Poses
    odometry: tuple[Odometry | None, ...]
    counts: ImageCounts | None
    skipped: Mapping[str, int]
    notices: tuple[str, ...]
    assumed_hz: int | None
    lacks: Mapping[str, str]
    recorded: bool
    pairs: tuple[Pair, ...]
    views: tuple[ViewCheck, ...]
    colours: Colours

    def __len__(self) -> int:
        return len(self.times_ns)

    @property
    def seconds(self) -> Float64[np.ndarray, " n"]:
        """Since the first image, (n,)."""
        return (self.times_ns - self.times_ns[0]) * 1e-9

    @property
    def gaps(self) -> list[tuple[float, float]]:
        """Long gaps between images: seconds since the first image, and duration, from the longest down."""
        if self.assumed_hz is not None or len(self) < 3:
            return []
        steps = np.diff(self.seconds)
        long = np.flatnonzero(steps > max(_GAP_STEPS * float(np.median(steps)), _GAP_S))
        found = [(float(self.seconds[i]), float(steps[i])) for i in long]
        return sorted(found, key=lambda gap: -gap[1])

    @property
    def frozen(self) -> list[tuple[int, int]]:
        """First and last of at least three images in a row that are equal."""
        begins = np.flatnonzero(~self.looks.repeated)
        lengths = np.diff([*begins.tolist(), len(self)])
        long = lengths >= _LEAST_RUN
        return [(begin, begin + length - 1) for begin, length in np.stack([begins, lengths], axis=1)[long].tolist()]

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
        if len(self.poses) < 2 or self.assumed_hz is not None:
            return None
        seconds = np.maximum(np.diff(self.seconds[self.posed]), 1e-9)
        return float(np.median(np.linalg.norm(np.diff(self.poses.translation, axis=0), axis=1) / seconds))

    @property
    def blur_comes_with(self) -> str | None:
        """ "turns" or "speed", whichever is larger in blurred images; None where unknown."""
        known = np.array([step is not None and step.duration_s > 0 for step in self.odometry])
        if known.sum() >= _RIPE:
            steps = [step for step, is_known in zip(self.odometry, known, strict=True) if step is not None and is_known]
            rates = np.stack([step.previous_from_current.log() / step.duration_s for step in steps])
            blurred = self.looks.blurred[known]
        elif len(self.poses) >= _RIPE and self.assumed_hz is None:
            at = np.flatnonzero(self.posed)
            seconds = np.maximum(np.diff(self.seconds[at]), 1e-9)
            rates = (self.poses[:-1].inverse() @ self.poses[1:]).log() / seconds[:, None]
            blurred = self.looks.blurred[at[1:]]
        else:
            return None
        if not blurred.any() or blurred.all():
            return None
        speed, turn = (np.linalg.norm(rates[:, part], axis=1) for part in (slice(0, 3), slice(3, 6)))
        grown = [float(np.median(rate[blurred]) / max(np.median(rate[~blurred]), 1e-9)) for rate in (speed, turn)]
        if max(grown) < 1.2:
            return None
        return "turns" if grown[1] >= grown[0] else "speed"

    def as_json(self) -> dict[str, Any]:
        """Figures for the report."""
        steps = np.diff(self.seconds)
        looks = self.looks
        return {
            "name": self.name,
            "images": len(self),
            "images_with_true_pose": int(self.posed.sum()),
            "images_with_odometry": sum(step is not None for step in self.odometry),
            "duration_s": float(self.seconds[-1]),
            "rate_hz": float(1.0 / np.median(steps)) if len(steps) and self.assumed_hz is None else None,
            "sizes": {f"{w} x {h}": count for (w, h), count in self.sizes.items()},
            "path_m": self.path_m,
            "sharpness": float(np.median(looks.sharpness)),
            "brightness": float(np.median(looks.brightness)),
            "blurred": float(looks.blurred.mean()),
            "blur_comes_with": self.blur_comes_with,
            "dark": float(looks.dark.mean()),
            "blown_out": float(looks.blown.mean()),
            "brightness_jumps": np.flatnonzero(looks.jumps).tolist(),
            "frozen_images": [list(run) for run in self.frozen],
            "gaps": [{"at_s": at_s, "seconds": long_s} for at_s, long_s in self.gaps],
            "counts": None if self.counts is None else self.counts.as_json(),
            "skipped": dict(self.skipped),
            "notices": list(self.notices),
            "lacks": dict(self.lacks),
            "views": [asdict(check) for check in self.views],
        }
