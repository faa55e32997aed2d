"""Whether images have the clock of odometry and true poses: their view shifts as the camera turns."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from filtering.se3 import Poses
from sequences.errors import SequenceError
from sequences.frame import Trajectory
from sequences.trajectories.time_offset import find_time_offset
from vapor.inspection.odometry import chained
from vapor.inspection.walk import Walk
from vapor.training_data.ground import runs

_USUAL_OFFSET_S = 3.0  # at most, within one recording
_CERTAIN_S = 0.02  # standard deviation, at most


@dataclass(frozen=True)
class ImageClock:
    """How much later the stamps of a recording's images are than those of something else, of the same moment.

    Attributes:
        name: Of the recording.
        against: What they are compared with: "odometry", or without any "true poses"; None where there is neither.
        late_ms: Milliseconds; None where that cannot be said, as where the view hardly shifts.
    """

    name: str
    against: str | None
    late_ms: float | None

    @staticmethod
    def of(walk: Walk) -> ImageClock:
        """The clock of a recording's images, by how their view shifts."""
        others = {"odometry": _by_odometry(walk), "true poses": Trajectory(walk.times_ns[walk.posed], walk.poses)}
        against = next((what for what, track in others.items() if len(track) > 1), None)
        if against is None or walk.assumed_hz is not None:
            return ImageClock(walk.name, None, None)
        turns = Poses.exp(np.concatenate([np.zeros((len(walk), 3)), walk.turns], axis=1))
        seen = Trajectory(walk.times_ns, chained([turns[i] for i in range(1, len(walk))]))
        try:
            late_s = find_time_offset(seen, others[against], within_s=_USUAL_OFFSET_S, certain_s=_CERTAIN_S)
        except SequenceError:
            return ImageClock(walk.name, against, None)
        return ImageClock(walk.name, against, 1e3 * late_s)

    def as_json(self) -> dict[str, Any]:
        """For the report."""
        return asdict(self)


def _by_odometry(walk: Walk) -> Trajectory:
    """The longest segment of images that odometry leads through, in a frame of its own."""
    known = np.array([step is not None for step in walk.odometry])
    longest = max(runs(known, np.zeros(len(walk), np.int64)), key=lambda run: run.stop - run.start, default=slice(1, 1))
    steps = [step.previous_from_current for step in walk.odometry[longest] if step is not None]
    return Trajectory(walk.times_ns[longest.start - 1 : longest.stop], chained(steps))
