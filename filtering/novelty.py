"""Novelty of views from the motion alone: neighbouring images share what they show, which counts once."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from filtering.se3 import Poses
from filtering.unchecked import unchecked_replace

_REMEMBERED = 60  # views
_STEP = 0.1  # of a length: less is jitter


@dataclass(frozen=True)
class NoveltyTracker:
    """Measures motion in lengths over which a camera's view becomes a new one.

    `observe` gives the novelty of a view: the fraction of its image's information that earlier images lack. It grows
    with the distance from the nearest of the views remembered and is spent as it grows. So one length moved is worth
    one image at any rate, and standing, trembling or pacing up and down is worth nothing. `predict` gives the
    normalized distance that the camera moved, over which the errors of its images lose their correlation. It grows in
    steps of a tenth of a length, so that jitter adds no distance.

    Attributes:
        length_m: Distance that makes a view a new one, metres.
        length_rad: Angle that does, radians.
        pose: The camera now, in the frame of the first view, by odometry.
        views: Those remembered, batch (k,), the last one the latest.
        spent: Novelty of the present view that earlier images have used, in [0, 1].
        anchor: Where the last step ended.
        reached: Largest distance from it since, in lengths.
        unknown: Distance that the camera may have come without odometry since the last view, in lengths.
        normalized_distance: Of the camera since the last image, in lengths.
    """

    length_m: float
    length_rad: float
    pose: Poses = field(default_factory=Poses.identity)
    views: Poses = field(default_factory=lambda: Poses.identity(1))
    spent: float = 0.0
    anchor: Poses = field(default_factory=Poses.identity)
    reached: float = 0.0
    unknown: float = 0.0
    normalized_distance: float = 0.0

    def predict(self, previous_from_current: Poses) -> tuple[NoveltyTracker, float]:
        """The tracker after a motion (one pose), and the normalized distance of the motion."""
        pose = self.pose @ previous_from_current
        distance = float(self._lengths(self.anchor, pose))
        moved = max(distance - self.reached, 0.0)
        in_all = self.normalized_distance + moved
        anchor, reached = (pose, 0.0) if distance >= _STEP else (self.anchor, max(self.reached, distance))
        after = unchecked_replace(self, pose=pose, anchor=anchor, reached=reached, normalized_distance=in_all)
        return after, moved

    def after_unknown(self, distance_m: float, angle_rad: float) -> tuple[NoveltyTracker, float]:
        """The same after a motion of which only the likely distance and angle are known."""
        moved = float(np.hypot(distance_m / self.length_m, angle_rad / self.length_rad))
        in_all = self.normalized_distance + moved
        return unchecked_replace(self, unknown=self.unknown + moved, normalized_distance=in_all), moved

    def observe(self) -> tuple[NoveltyTracker, float]:
        """The tracker after an image, and the novelty of its view, in [0, 1]."""
        distance = float(self._lengths(self.views, self.pose).min()) + self.unknown
        novelty = min(max(distance - self.spent, 0.0), 1.0)
        if distance < 1.0:
            return unchecked_replace(self, spent=max(self.spent, distance), normalized_distance=0.0), novelty
        # What lies before a gap is nowhere in particular.
        before = self.views if self.unknown == 0.0 else Poses.identity(0)
        here = Poses(self.pose.rotation[None], self.pose.translation[None])
        views = Poses.concatenate([before, here])[-_REMEMBERED:]
        return unchecked_replace(self, views=views, spent=0.0, unknown=0.0, normalized_distance=0.0), novelty

    def _lengths(self, one: Poses, other: Poses) -> np.ndarray:
        translation_m, rotation_rad = one.distance(other)
        return np.asarray(np.hypot(translation_m / self.length_m, rotation_rad / self.length_rad))
