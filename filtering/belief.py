"""The state of the filter as one immutable value."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from filtering.cameras import CameraMemory
from filtering.hypotheses import Hypotheses
from filtering.identity import KnownModes
from filtering.motion import GapMotion
from filtering.unchecked import unchecked_replace
from filtering.vertical import VerticalMemory


@dataclass(frozen=True)
class Belief:
    """The state of the filter; a step makes another one of it.

    Attributes:
        rng: Source of random draws. Nothing is drawn from it, but from a copy that the next belief keeps.
        hypotheses: Where the camera may be; None before the first image.
        unassigned: Probability that it is at none of these, but anywhere in the map.
        cameras: The memory of each camera, by its name.
        vertical: The memory of measured verticals; None before the first.
        known: The modes of the last estimate, moved since.
        calibrated: Whether the latest image had Student t tails, see `PosePosterior.calibrated`.
        agreement: Fraction of the belief that fits the latest images, in [0, 1].
        usual_agreement: The same over a longer time.
        unseen_s: Seconds since an image with any place, or one out of distribution.
        gap_motion: The latest motion, where odometry was missing.
        drift: Mean (6,) and covariance (6, 6) of the odometry's drift before a gap; None where odometry is known.
        usual_m_per_s: Average speed by odometry over the last seconds.
        provisional: Whether the next informative image replaces the belief.
        normalized_distance: Of the first camera since the last image, in lengths over which its errors are correlated.
    """

    rng: np.random.Generator
    hypotheses: Hypotheses | None = None
    unassigned: float = 1.0
    cameras: Mapping[str, CameraMemory] = field(default_factory=dict)
    vertical: VerticalMemory | None = None
    known: KnownModes = field(default_factory=KnownModes)
    calibrated: bool = False
    agreement: float = 1.0
    usual_agreement: float = 1.0
    unseen_s: float = 0.0
    gap_motion: GapMotion | None = None
    drift: tuple[np.ndarray, np.ndarray] | None = None
    usual_m_per_s: float = 0.0
    provisional: bool = False
    normalized_distance: float = 0.0

    def forgotten(self) -> Belief:
        """An empty belief with the same source of random draws; identities of modes are not given again."""
        return Belief(self.rng, known=self.known.forgotten())

    def with_camera(self, name: str, camera: CameraMemory) -> Belief:
        """The same with the memory of one camera replaced."""
        return unchecked_replace(self, cameras={**self.cameras, name: camera})

    @property
    def num_sources(self) -> int:
        """How many sources of lasting errors there are: networks, maps of landmarks, and verticals."""
        return sum(len(camera.sources) for camera in self.cameras.values()) + (self.vertical is not None)
