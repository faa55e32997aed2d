"""What watches a run while it goes on."""

from __future__ import annotations

from collections.abc import Mapping
from types import TracebackType
from typing import Protocol

from filtering.estimate import Estimate
from filtering.se3 import Poses
from sequences.frame import Frame, Trajectory


class Viewer(Protocol):
    """Watches a run; used in a `with` block, so that an error leaves no half-written recording."""

    def log(self, frame: Frame, estimate: Estimate, posterior_poses: Poses | None) -> None:
        """Show one image, the belief after it, and samples (m,) of the image's own posterior."""
        ...

    def close(self) -> None:
        """Finish; a recording appears under its name."""
        ...

    def __enter__(self) -> Viewer: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


class NullViewer:
    """Shows nothing, so that the loop never asks."""

    def log(self, frame: Frame, estimate: Estimate, posterior_poses: Poses | None) -> None:
        """Do nothing."""

    def log_at_end(self, methods: Mapping[str, Trajectory], truth: Trajectory | None) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""

    def __enter__(self) -> NullViewer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        pass
