"""Steps of a trajectory that are no motion: a map that was corrected, a false measurement."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median
from typing import NamedTuple

JUMP_CONTEXT = 2  # steps before and after one that tell whether it is a jump
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

    What moves is about as fast in the next step; a corrected map, or a false measurement, is so once or twice only.

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
