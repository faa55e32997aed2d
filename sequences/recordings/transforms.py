"""Transforms between frames -> the transform between any two of them, and which links it leads through."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from filtering.se3 import Poses
from sequences.recordings.messages import FrameTransform


@dataclass(frozen=True)
class Step:
    """One link of a path through the tree.

    Attributes:
        parent: Its upper frame.
        child: Its lower frame.
        parent_from_child: One pose, as it was last told.
        static: Whether it was told as one that never changes.
        upwards: Whether the path leads from the child to the parent.
    """

    parent: str
    child: str
    parent_from_child: Poses
    static: bool
    upwards: bool

    @property
    def link(self) -> tuple[str, str]:
        """Names of parent and child."""
        return self.parent, self.child


class TransformTree:
    """Frames and the transforms that join them; the latest transform of a child replaces the one before.

    Attributes:
        problem: What was wrong with the first transform that could not be taken in; '' where all could.
    """

    def __init__(self) -> None:
        self.problem = ""
        self._parents: dict[str, tuple[str, Poses, bool]] = {}

    @property
    def frames(self) -> list[str]:
        """Names of all frames, sorted."""
        return sorted({*self._parents, *(parent for parent, _, _ in self._parents.values())})

    def add(self, transforms: Iterable[FrameTransform], *, static: bool = False) -> None:
        """Take transforms in; static ones are those of `/tf_static`."""
        for t in transforms:
            self._parents[t.child] = (t.parent, t.parent_from_child, static)

    def between(self, target: str, source: str) -> Poses | None:
        """`target_from_source`, one pose, through the nearest common ancestor; None where there is none."""
        path = self.path(target, source)
        return None if path is None else along(path, [step.parent_from_child for step in path])

    def path(self, target: str, source: str) -> list[Step] | None:
        """The links from target to source, whose product is `target_from_source`; None where no path leads there."""
        up = [target, *self.ancestors(target)]
        down = [source, *self.ancestors(source)]
        common = next((frame for frame in up if frame in down), None)
        if common is None:
            return None
        rising = [self._step(frame, upwards=True) for frame in up[: up.index(common)]]
        falling = [self._step(frame, upwards=False) for frame in down[: down.index(common)]]
        return rising + falling[::-1]

    def ancestors(self, frame: str) -> list[str]:
        """All frames above one, nearest first."""
        chain = [frame]
        while frame in self._parents:
            frame = self._parents[frame][0]
            if frame in chain:  # a loop in the recording
                break
            chain.append(frame)
        return chain[1:]

    def _step(self, child: str, *, upwards: bool) -> Step:
        parent, pose, static = self._parents[child]
        return Step(parent, child, pose, static, upwards)


def along(path: Sequence[Step], poses: Sequence[Poses]) -> Poses:
    """The product of the links of a path, one pose, where they have the given `parent_from_child`."""
    product = Poses.identity()
    for step, pose in zip(path, poses, strict=True):
        product = product @ (pose.inverse() if step.upwards else pose)
    return product
