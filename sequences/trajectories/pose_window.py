"""The end of a stream of time-stamped poses, queried in order of time, and its jumps."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field
from statistics import median
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from filtering.motion import Odometry, WhiteNoise
from filtering.se3 import Poses
from sequences.trajectories.interpolation import odometry_between, pose_at

JUMP_CONTEXT = 2  # steps before and after that decide whether one is a jump
_LEAST_JUMP_M, _LEAST_JUMP_RAD = 0.1, 0.1
_JUMP_RATIO = 5.0  # how many times as fast as the steps around it
_LONGEST_JUMP_S = 0.5  # in longer steps bodies set off, turn and stop


class Motion(NamedTuple):
    """How far one pose is from the one before: metres, radians, seconds."""

    metres: float
    radians: float
    seconds: float

    @property
    def is_large(self) -> bool:
        """Whether it is far enough for a jump."""
        return self.metres > _LEAST_JUMP_M or self.radians > _LEAST_JUMP_RAD


def is_jump(steps: Sequence[Motion], index: int) -> bool:
    """Whether a step is no motion: far, and many times as fast as those before and after it.

    Motion is about as fast in the next step; a corrected map, or a false measurement, is fast once or twice only.

    Args:
        steps: Consecutive steps, the first of which leads from nowhere.
        index: Which of them, at least 1.
    """
    step = steps[index]
    if not step.is_large or step.seconds > _LONGEST_JUMP_S:
        return False
    near = [
        steps[i] for i in range(index - JUMP_CONTEXT, index + JUMP_CONTEXT + 1) if i != index and 0 < i < len(steps)
    ]
    if not near:
        return False
    usual_m = median(s.metres / s.seconds for s in near)
    usual_rad = median(s.radians / s.seconds for s in near)
    return (step.metres > _LEAST_JUMP_M and step.metres > _JUMP_RATIO * usual_m * step.seconds) or (
        step.radians > _LEAST_JUMP_RAD and step.radians > _JUMP_RATIO * usual_rad * step.seconds
    )


_STEPS_BEFORE = 4
_UNKNOWN = np.zeros((6, 6))
_UNKNOWN.setflags(write=False)


@dataclass
class PoseWindow:
    """The end of a stream of time-stamped poses: poses that are no longer needed are forgotten.

    Poses may come out of order, as long as no later time was asked for.

    Attributes:
        max_gap_s: Neighbours further apart than this do not cover what lies between them.
        still_gap_s: The same of neighbours that hardly differ, where it is longer: see `pose_at`.
        watch_jumps: Whether to find jumps (`is_jump`), for `jumps_at`.
        num_jumps: How many were found so far.
        first_jump_ns: When the first of them was over.
        begin_ns: Earliest stamp of all poses that ever came; None before.
        end_ns: The latest one.
    """

    max_gap_s: float
    still_gap_s: float = 0.0
    watch_jumps: bool = False
    num_jumps: int = field(default=0, init=False)
    first_jump_ns: int | None = field(default=None, init=False)
    begin_ns: int | None = field(default=None, init=False)
    end_ns: int | None = field(default=None, init=False)
    _times_ns: list[int] = field(default_factory=list)
    _poses: list[Poses] = field(default_factory=list)
    _covariances: list[np.ndarray] = field(default_factory=list)
    _steps: list[Motion] = field(default_factory=list)  # to each pose from the one before
    _settled_ns: int | None = None  # up to here nothing is taken any more

    def append(self, time_ns: int, pose: Poses, covariance: Float64[np.ndarray, "6 6"] | None = None) -> bool:
        """Take a pose; False, and nothing taken, where there is one of its stamp, or it comes too late."""
        at = bisect_left(self._times_ns, time_ns)
        is_known = at < len(self._times_ns) and self._times_ns[at] == time_ns
        if is_known or (self._settled_ns is not None and time_ns <= self._settled_ns):
            return False
        self._times_ns.insert(at, time_ns)
        self._poses.insert(at, pose)
        self._covariances.insert(at, _UNKNOWN if covariance is None else covariance)
        if self.watch_jumps:
            self._steps.insert(at, self._step(at))
            if at + 1 < len(self._steps):
                self._steps[at + 1] = self._step(at + 1)
        self.begin_ns = time_ns if self.begin_ns is None else min(self.begin_ns, time_ns)
        if self.end_ns is None or time_ns > self.end_ns:
            self.end_ns = time_ns
            self._count_jump(len(self._steps) - 1 - JUMP_CONTEXT)
        return True

    def _step(self, index: int) -> Motion:
        before = max(index - 1, 0)
        metres, radians = self._poses[before].distance(self._poses[index])
        return Motion(float(metres), float(radians), (self._times_ns[index] - self._times_ns[before]) * 1e-9)

    def finish(self) -> None:
        """No pose comes any more: look for jumps among the last steps as well."""
        for index in range(max(len(self._steps) - JUMP_CONTEXT, 0), len(self._steps)):
            self._count_jump(index)

    def reaches(self, time_ns: int) -> bool:
        """Whether a pose at or after this time has come."""
        return bool(self._times_ns) and self._times_ns[-1] >= time_ns

    def forget_before(self, time_ns: int) -> None:
        """Drop what lies before the last pose that is at or before this time, but for the steps that decide on jumps.

        A pose that comes later and lies before the pose after this time would change earlier answers: it is not taken.
        """
        after = bisect_left(self._times_ns, time_ns)
        settled_ns = self._times_ns[after] if after < len(self._times_ns) else time_ns
        self._settled_ns = settled_ns if self._settled_ns is None else max(self._settled_ns, settled_ns)
        keep = bisect_right(self._times_ns, time_ns) - 1 - (2 * JUMP_CONTEXT + 1 if self.watch_jumps else 0)
        if keep > 0:
            del self._times_ns[:keep], self._poses[:keep], self._covariances[:keep], self._steps[:keep]

    def at(self, time_ns: int) -> Poses | None:
        """The pose at one time; None where it is not covered."""
        after = bisect_left(self._times_ns, time_ns)
        near = slice(max(after - 1, 0), after + 1)
        return pose_at(
            self._times_ns[near],
            self._poses[near],
            time_ns,
            max_gap_s=self.max_gap_s,
            still_gap_s=self.still_gap_s,
        )

    def covers(self, time_ns: int) -> bool:
        """Whether there is a pose at one time, by `max_gap_s` alone."""
        after = bisect_left(self._times_ns, time_ns)
        if after == len(self._times_ns):
            return False
        is_known = self._times_ns[after] == time_ns
        return is_known or (after > 0 and self._times_ns[after] - self._times_ns[after - 1] <= self.max_gap_s * 1e9)

    def leads(self, start_ns: int, end_ns: int) -> bool:
        """Whether the motion between two covered times is known: no neighbours are too far apart, and none jump.

        A jump is found by the steps before it alone, so that nothing need be waited for: far, and many times as fast.
        """
        first, end = bisect_right(self._times_ns, start_ns) - 1, bisect_left(self._times_ns, end_ns) + 1
        if first < 0:  # forgotten
            return False
        near = slice(max(first - _STEPS_BEFORE, 0), end)
        seconds = np.diff(self._times_ns[near]) * 1e-9
        begin = first - near.start
        if (seconds[begin:] > self.max_gap_s).any():
            return False
        poses = Poses.stack(self._poses[near])
        metres, radians = poses[:-1].distance(poses[1:])
        steps = [Motion(*each) for each in zip(metres.tolist(), radians.tolist(), seconds.tolist(), strict=True)]
        return not any(
            is_jump(steps[max(index - _STEPS_BEFORE, 0) : index + 1], min(index, _STEPS_BEFORE))
            for index in range(begin, len(steps))
            if steps[index].is_large
        )

    def jumps_at(self, time_ns: int) -> bool:
        """Whether a time lies between two poses with a jump between them."""
        after = bisect_left(self._times_ns, time_ns)
        if not self._steps or not 0 < after < len(self._times_ns) or self._times_ns[after] == time_ns:
            return False
        return is_jump(self._steps, after)

    def _count_jump(self, index: int) -> None:
        if index > 0 and is_jump(self._steps, index):
            self.num_jumps += 1
            self.first_jump_ns = self._times_ns[index] if self.first_jump_ns is None else self.first_jump_ns

    def odometry_between(
        self, start_ns: int, end_ns: int, *, base_from_camera: Poses, motion_noise: WhiteNoise
    ) -> Odometry:
        """`odometry_between` two covered times, the first of which was not yet forgotten."""
        near = slice(bisect_right(self._times_ns, start_ns) - 1, bisect_left(self._times_ns, end_ns) + 1)
        return odometry_between(
            np.array(self._times_ns[near], np.int64),
            Poses.stack(self._poses[near]),
            np.concatenate(self._covariances[near]).reshape(-1, 6, 6),
            start_ns,
            end_ns,
            base_from_camera=base_from_camera,
            motion_noise=motion_noise,
        )
