"""One recording as it is inspected: a few numbers for each image."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int64

from filtering.motion import Odometry
from filtering.se3 import Poses
from sequences.reading.counts import ImageCounts
from vapor.inspection.looks import Looks
from vapor.training_data.checks import Colours
from vapor.training_data.views import Pair, ViewCheck

_GAP_STEPS, _GAP_S = 3.0, 0.25  # longer than so many usual steps, and than so long
_LEAST_RUN = 3  # images that are one and the same
_RIPE = 50  # images with odometry or poses, to say whether blur comes with turns


@dataclass(frozen=True)
class Walk:
    """One recording of n images, without its pixels.

    Attributes:
        name: Of its file or folder.
        times_ns: Stamps, (n,).
        sizes: Width and height of images, pixels, and how many have them.
        looks: How its images look.
        posed: Which of them have a true pose, (n,).
        poses: These k poses, world_from_camera.
        odometry: Motion since the image before, n of them; None where it is not known.
        counts: What became of the images of the recording, those that were not asked for among the skipped ones; None
            of images on disk.
        skipped: What was left out in reading, by reason: images, and messages that could not be read.
        notices: What the reader says of odometry and true poses.
        assumed_hz: The rate that was assumed for want of stamps; None where they were recorded.
        lacks: What was not found, "true poses" and "odometry", and why.
        recorded: Whether it is a recording, rather than images on disk.
        pairs: Images that show the same, spread over the recording.
        views: How what its images show compares with how true poses and odometry say that it moved.
        colours: Which colours it has.
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
        """Where no image is for long: seconds since the first image, and how long, from the longest down."""
        if self.assumed_hz is not None or len(self) < 3:
            return []
        steps = np.diff(self.seconds)
        long = np.flatnonzero(steps > max(_GAP_STEPS * float(np.median(steps)), _GAP_S))
        found = [(float(self.seconds[i]), float(steps[i])) for i in long]
        return sorted(found, key=lambda gap: -gap[1])

    @property
    def frozen(self) -> list[tuple[int, int]]:
        """First and last of images in a row that are one and the same, three at least."""
        begins = np.flatnonzero(~self.looks.repeated)
        lengths = np.diff([*begins.tolist(), len(self)])
        return [
            (int(begin), int(begin + length - 1))
            for begin, length in zip(begins, lengths, strict=True)
            if length >= _LEAST_RUN
        ]

    @property
    def path_m(self) -> float | None:
        """How far the camera came, by true poses or else by odometry; None without either."""
        if len(self.poses):
            return float(np.linalg.norm(np.diff(self.poses.translation, axis=0), axis=1).sum())
        moved = [np.linalg.norm(step.previous_from_current.translation) for step in self.odometry if step is not None]
        return float(np.sum(moved)) if moved else None

    @property
    def speed_m_per_s(self) -> float | None:
        """Median speed of the camera by true poses; None where it is not known."""
        if len(self.poses) < 2 or self.assumed_hz is not None:
            return None
        seconds = np.maximum(np.diff(self.seconds[self.posed]), 1e-9)
        return float(np.median(np.linalg.norm(np.diff(self.poses.translation, axis=0), axis=1) / seconds))

    @property
    def blur_comes_with(self) -> str | None:
        """ "turns" or "speed", by which of the two is larger in blurred images; None where that cannot be said."""
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
