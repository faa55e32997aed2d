"""A viewer can be slow, fail or hang: what it watches goes on."""

import threading
import time
from typing import Any

import numpy as np
import pytest

from filtering.errors import VaporTrackError
from filtering.estimate import Estimate
from sequences.frame import Frame
from tests.helpers.simulation import new_localizer, walk
from vapor.reporting.rerun_viewer import RerunViewer
from vapor.robot import viewers
from vapor.robot.viewers import WatchingViewer


class Shown(RerunViewer):
    """A viewer that remembers stamps; it may wait for a turn, or fail."""

    def __init__(self, *, turn: threading.Event | None = None, error: Exception | None = None) -> None:
        self.stamps: list[int] = []
        self.turn, self.error, self.is_closed = turn, error, False

    def log(self, frame: Frame, estimate: Estimate, posterior_poses: Any) -> None:
        self.stamps.append(frame.time_ns)
        if self.error is not None:
            raise self.error
        if self.turn is not None:
            self.turn.wait(5)

    def close(self, *, keep: bool = True) -> None:
        self.is_closed = True


@pytest.fixture(scope="module")
def estimate() -> Estimate:
    estimates, _ = walk(new_localizer(), 1)
    return estimates[0]


def show(viewer: WatchingViewer, estimate: Estimate, *stamps: int) -> None:
    for time_ns in stamps:
        viewer.log(Frame(time_ns, np.zeros((4, 4, 3), np.uint8)), estimate, None)


def test_a_slow_one_skips_to_the_newest(estimate: Estimate) -> None:
    turn = threading.Event()
    shown = Shown(turn=turn)
    with WatchingViewer(lambda: shown, lambda _: None) as viewer:
        show(viewer, estimate, 1)
        while not shown.stamps:
            time.sleep(0.001)
        show(viewer, estimate, *range(2, 100))
        turn.set()
    assert shown.stamps == [1, 99]
    assert shown.is_closed


def test_one_that_hangs_holds_up_neither_images_nor_the_end(
    estimate: Estimate, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(viewers, "_LEAVE_S", 0.1)
    turn = threading.Event()
    begin_s = time.monotonic()
    with WatchingViewer(lambda: Shown(turn=turn), lambda _: None) as viewer:
        show(viewer, estimate, *range(100))
    assert time.monotonic() - begin_s < 1.0
    turn.set()


def test_one_that_fails_is_said_once(estimate: Estimate) -> None:
    told: list[str] = []
    with WatchingViewer(lambda: Shown(error=VaporTrackError("gone")), told.append) as viewer:
        show(viewer, estimate, 1)
        while not told:
            time.sleep(0.001)
        show(viewer, estimate, 2, 3)
    assert told == ["the viewer stopped: gone"]


def test_without_a_display_no_window_is_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(VaporTrackError, match="needs a display, expected DISPLAY or WAYLAND_DISPLAY"):
        RerunViewer(spawn=True)


def test_an_address_that_is_none_is_named() -> None:
    with pytest.raises(VaporTrackError, match="no Rerun viewer can be reached at 'nonsense'"):
        RerunViewer(connect="nonsense")
