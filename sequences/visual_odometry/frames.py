"""Frames in, one after the other; the same with visual odometry out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from filtering.motion import Odometry, joined
from sequences.frame import Camera, Frame
from sequences.images.undistortion import same_aspect
from sequences.visual_odometry.fusion import OdometryFusion
from sequences.visual_odometry.odometry import USUAL_DEPTH_M, VisualOdometry

TRACKED_HZ = 15.0
"""Features are tracked in so many images a second; more would not be more exact."""
_SILENT_S = 1.0  # without an image of the camera that is localized, after which others do not wait for it
_TOLERANCE = 0.1  # of the time between frames: stamps tremble


class VisualFrames:
    """Gives frames the motion that their images show, for whole sequences and for streams alike.

    Of several cameras the one that is localized shows the motion; images of the others wait for its next one, and are
    taken along.

    Attributes:
        num_unknown: Frames before which the images did not say how the camera moved.
        num_between: Frames that only showed the motion.
    """

    def __init__(
        self,
        camera: Camera,
        *,
        beside: bool = False,
        most_hz: float = np.inf,
        usual_depth_m: float = USUAL_DEPTH_M,
    ) -> None:
        """Before the first frame; arguments as of `VisualSequence`."""
        self._camera, self._most_hz, self._usual_depth_m = camera, most_hz, usual_depth_m
        self.num_unknown = self.num_between = 0
        self._visual: VisualOdometry | None = None
        self._fusion = OdometryFusion() if beside else None
        self._recorded: list[Odometry | None] = []  # since the latest image whose features were tracked
        self._since: list[Odometry | None] = []  # since the latest frame that was given
        self._tracked, self._given = Rate(max(TRACKED_HZ, most_hz)), Rate(most_hz)
        self._rates, self._others = dict[str, Rate](), list[Frame]()
        self._last_ns: int | None = None
        self._showed_ns: int | None = None  # stamp of the latest image of the camera that is localized

    @property
    def disagreed_s(self) -> float:
        """Seconds during which recorded and visual odometry disagreed."""
        return 0.0 if self._fusion is None else self._fusion.disagreed_s

    @property
    def disagreement(self) -> list[str]:
        """A sentence for users where recorded and visual odometry disagreed."""
        if self.disagreed_s == 0.0:
            return []
        return [
            f"recorded and visual odometry disagree for {self.disagreed_s:.1f} s: wheels slip, or something moves in"
            " the images"
        ]

    @property
    def since(self) -> Odometry | None:
        """The motion since the latest frame that was given, to the latest that was taken; None where it is unknown."""
        return joined([*self._since, joined(self._recorded)])

    def settle(self) -> None:
        """Begin the next motion at a later time than all frames so far."""
        self._recorded, self._since = [], []

    def take(self, frame: Frame) -> Iterator[Frame]:
        """Take the next frame in time; gives those that are then complete, in order."""
        self._recorded.append(frame.odometry)
        if frame.reference_from_camera is not None:
            yield from self._take_other(frame)
            return
        self._showed_ns = frame.time_ns
        if not self._tracked.is_due(frame.time_ns):
            self.num_between += 1
            return
        camera, odometry = self._camera_of(frame), None
        if camera is None:
            self._visual = None
        else:
            self._visual = self._visual or VisualOdometry(camera, usual_depth_m=self._usual_depth_m)
            odometry = self._visual.step(frame.image, frame.time_ns, camera)
        self.num_unknown += self._last_ns is not None and odometry is None
        if self._fusion is not None:
            odometry = self._fusion.step(joined(self._recorded), odometry)
        self._recorded = []
        self._since.append(odometry)
        if not self._given.is_due(frame.time_ns):
            self.num_between += 1
            return
        yield from _along([*self._others, frame], None if self._last_ns is None else joined(self._since), self._last_ns)
        self._since, self._others, self._last_ns = [], [], frame.time_ns

    def _take_other(self, frame: Frame) -> Iterator[Frame]:
        """Take a frame of a camera beside the one that is localized."""
        is_due = self._rates.setdefault(frame.camera_name, Rate(self._most_hz)).is_due(frame.time_ns)
        self._others += [frame] if is_due else []
        self.num_between += not is_due
        showed_ns = self._showed_ns = frame.time_ns if self._showed_ns is None else self._showed_ns
        if is_due and (frame.time_ns - showed_ns) * 1e-9 > _SILENT_S:  # the first camera shows nothing
            is_known = self._fusion is not None and self._last_ns is not None
            motion = joined([*self._since, joined(self._recorded)]) if is_known else None
            yield from _along(self._others, motion, self._last_ns)
            self._last_ns, self._visual = self._others[-1].time_ns, None
            self._recorded, self._since, self._others = [], [], []

    def finish(self) -> Iterator[Frame]:
        """The frames that are left, after the last one."""
        yield from _along(self._others, None, self._last_ns)
        self._others = []

    def _camera_of(self, frame: Frame) -> Camera | None:
        """The intrinsics of a frame; None where neither it nor the camera assumed has any."""
        height, width = frame.image.shape[:2]
        if frame.camera is not None:
            return frame.camera
        return self._camera.scaled(width, height) if same_aspect(self._camera, width, height) else None


def _along(frames: Sequence[Frame], motion: Odometry | None, begin_ns: int | None) -> Iterator[Frame]:
    """Frames in order, with their parts of the motion from a time to the last of them."""
    for frame in frames:
        part = None
        if motion is not None and begin_ns is not None:
            left_ns = frames[-1].time_ns - begin_ns
            part = motion.part((frame.time_ns - begin_ns) / left_ns) if frame is not frames[-1] else motion
            motion, begin_ns = motion.after(part), frame.time_ns
        yield replace(frame, odometry=part)


class Rate:
    """Chooses images, so many a second on average."""

    def __init__(self, hz: float) -> None:
        self._period_ns, self._due_ns = 1e9 / hz, -np.inf

    def is_due(self, time_ns: int) -> bool:
        """Whether the next image, of a later time than those before, is one."""
        if time_ns < self._due_ns - _TOLERANCE * self._period_ns:
            return False
        missed = self._due_ns <= time_ns - self._period_ns
        self._due_ns = (time_ns if missed else self._due_ns) + self._period_ns
        return True
