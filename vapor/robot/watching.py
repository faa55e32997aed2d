"""A viewer that watches live localization, and can never hold it up: it gets the newest belief when it has time."""

from __future__ import annotations

import threading
from collections.abc import Callable
from types import TracebackType

from filtering.errors import VaporTrackError
from filtering.estimate import Estimate
from filtering.se3 import Poses
from sequences.frame import Frame
from vapor.reporting.rerun_viewer import RerunViewer

_LEAVE_S = 3.0  # that a viewer gets at the end


class WatchingViewer:
    """Shows what goes on in a thread of its own; one that is slower than the camera skips images.

    A viewer that takes nothing any more, as its window was closed or the network to it is gone, is left alone.

    Args:
        opened: Makes the viewer; called here, so that its errors come at once.
        tell: Told, once, that it failed.
    """

    def __init__(self, opened: Callable[[], RerunViewer], tell: Callable[[str], None]) -> None:
        self._viewer, self._tell = opened(), tell
        self._newest: tuple[Frame, Estimate, Poses | None] | None = None
        self._closed = False
        self._turn = threading.Condition()
        self._thread = threading.Thread(target=self._work, name="viewer", daemon=True)
        self._thread.start()

    def log(self, frame: Frame, estimate: Estimate, posterior_poses: Poses | None) -> None:
        """Show this next, whatever was to be shown."""
        with self._turn:
            self._newest = frame, estimate, posterior_poses
            self._turn.notify()

    def close(self) -> None:
        """Show no more."""
        with self._turn:
            self._closed = True
            self._turn.notify()
        self._thread.join(_LEAVE_S)

    def __enter__(self) -> WatchingViewer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _work(self) -> None:
        try:
            while True:
                with self._turn:
                    self._turn.wait_for(lambda: self._closed or self._newest is not None)
                    shown, self._newest = self._newest, None
                if shown is None:
                    break
                self._viewer.log(*shown)
            self._viewer.close()
        except VaporTrackError as error:
            self._tell(f"the viewer shows no more: {error}")
