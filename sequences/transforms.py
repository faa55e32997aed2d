"""Transforms between frames -> the transform between any two of them."""

from __future__ import annotations

from collections.abc import Iterable

from filtering.se3 import Poses
from sequences.messages import FrameTransform


class TransformTree:
    """Frames and the transforms that join them; the latest transform of a child replaces the one before."""

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, Poses]] = {}

    @property
    def frames(self) -> list[str]:
        """Names of all frames, sorted."""
        return sorted({*self._parents, *(parent for parent, _ in self._parents.values())})

    def add(self, transforms: Iterable[FrameTransform]) -> None:
        """Take transforms in."""
        for t in transforms:
            self._parents[t.child] = (t.parent, t.parent_from_child)

    def between(self, target: str, source: str) -> Poses | None:
        """`target_from_source`, one pose, through the nearest common ancestor; None where there is none."""
        ancestor_from_target = self._ancestors(target)
        ancestor_from_source = self._ancestors(source)
        for frame, frame_from_target in ancestor_from_target.items():
            if frame in ancestor_from_source:
                return frame_from_target.inverse() @ ancestor_from_source[frame]
        return None

    def _ancestors(self, frame: str) -> dict[str, Poses]:
        """`ancestor_from_frame` of a frame and all above it, nearest first."""
        chain = {frame: Poses.identity()}
        while frame in self._parents:
            parent, parent_from_frame = self._parents[frame]
            if parent in chain:  # a loop in the recording
                break
            chain[parent] = parent_from_frame @ chain[frame]
            frame = parent
        return chain
