"""A sequence whose odometry is made from its images, alone or beside what was recorded."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from filtering.motion import Odometry, joined
from sequences.frame import Camera, Frame
from sequences.frame_source import FrameSource
from sequences.images.undistortion import same_aspect
from sequences.reading.counts import BETWEEN, ImageCounts
from sequences.visual_odometry.fusion import OdometryFusion
from sequences.visual_odometry.odometry import USUAL_DEPTH_M, VisualOdometry

_TRACKED_HZ = 15.0  # features are tracked in so many images a second; more would not be more exact
_SILENT_S = 1.0  # without an image of the camera that is localized, after which others do not wait for it
_TOLERANCE = 0.1  # of the time between frames: stamps tremble


class VisualSequence:
    """The frames of another sequence, with visual odometry.

    Of several cameras the one that is localized shows the motion; images of the others are taken along it.

    Attributes: those of the other sequence, but for

        has_odometry: True.
        odometry_description: Says that it is visual.
        beside: Whether recorded odometry is used as well.
    """

    has_odometry = True

    def __init__(
        self,
        frames: FrameSource,
        camera: Camera,
        *,
        beside: bool = False,
        restated: Callable[[Odometry], Odometry] | None = None,
        most_hz: float = np.inf,
        usual_depth_m: float = USUAL_DEPTH_M,
    ) -> None:
        """Around a sequence.

        Args:
            frames: The sequence.
            camera: Of the images that state none and have its aspect ratio; scaled to their size.
            beside: Whether recorded odometry is used as well: both correct each other (`OdometryFusion`). Otherwise it
                is replaced.
            restated: Gives recorded odometry with its fitted noise.
            most_hz: Frames a second that are given at most, on average; the images between them only show how the
                camera moved.
            usual_depth_m: How far away the scene usually is, metres.
        """
        self._frames, self._camera, self.beside = frames, camera, beside
        self._restated, self._most_hz, self._usual_depth_m = restated, most_hz, usual_depth_m
        self.path, self.camera, self.num_images = frames.path, frames.camera, frames.num_images
        self.image_description = frames.image_description
        recorded = frames.odometry_description or "recorded"
        self.odometry_description: str | None = f"{recorded}, and visual" if beside else "visual"
        self._num_unknown = self._num_between = 0
        self._disagreed_s = 0.0

    @property
    def counts(self) -> ImageCounts:
        """Counts of the images of the latest iteration; complete after it."""
        counts = self._frames.counts
        return replace(counts, used=counts.used - self._num_between, skipped=counts.skipped + self._between)

    @property
    def _between(self) -> Counter[str]:
        return +Counter({BETWEEN: self._num_between})

    @property
    def skipped(self) -> Counter[str]:
        """How many images of the latest iteration were left out, by reason."""
        return self._frames.skipped + self._between

    @property
    def resolved(self) -> dict[str, Any]:
        """The options that would read the same."""
        return self._frames.resolved

    @property
    def notices(self) -> list[str]:
        """Sentences for users; complete after an iteration."""
        notices = [*self._frames.notices]
        if self._num_unknown:
            notices.append(f"before {self._num_unknown} images the images do not say how the camera moved")
        if self._disagreed_s > 0.0:
            notices.append(
                f"recorded and visual odometry disagree for {self._disagreed_s:.1f} s: wheels slip, or something moves"
                " in the images"
            )
        return notices

    def __iter__(self) -> Iterator[Frame]:
        """Frames in order of time, see the sequence."""
        self._num_unknown = self._num_between = 0
        self._disagreed_s = 0.0
        visual: VisualOdometry | None = None
        recorded: list[Odometry | None] = []
        since: list[Odometry | None] = []
        tracked, given = Rate(max(_TRACKED_HZ, self._most_hz)), Rate(self._most_hz)
        rates, others = dict[str, Rate](), list[Frame]()
        last_ns: int | None = None
        fusion = OdometryFusion() if self.beside else None
        for frame in self._frames:
            motion = frame.odometry
            recorded.append(motion if motion is None or self._restated is None else self._restated(motion))
            if frame.reference_from_camera is not None:
                is_due = rates.setdefault(frame.camera_name, Rate(self._most_hz)).is_due(frame.time_ns)
                others += [frame] if is_due else []
                self._num_between += not is_due
                if is_due and (frame.time_ns - others[0].time_ns) * 1e-9 > _SILENT_S:  # the first camera shows nothing
                    motion = joined([*since, joined(recorded)]) if self.beside and last_ns is not None else None
                    yield from _along(others, motion, last_ns)
                    recorded, since, others, last_ns, visual = [], [], [], others[-1].time_ns, None
                continue
            if not tracked.is_due(frame.time_ns):
                self._num_between += 1
                continue
            camera, odometry = self._camera_of(frame), None
            if camera is None:
                visual = None
            else:
                visual = visual or VisualOdometry(camera, usual_depth_m=self._usual_depth_m)
                odometry = visual.step(frame.image, frame.time_ns, camera)
            self._num_unknown += last_ns is not None and odometry is None
            if fusion is not None:
                odometry = fusion.step(joined(recorded), odometry)
                self._disagreed_s = fusion.disagreed_s
            recorded = []
            since.append(odometry)
            if not given.is_due(frame.time_ns):
                self._num_between += 1
                continue
            yield from _along([*others, frame], None if last_ns is None else joined(since), last_ns)
            since, others, last_ns = [], [], frame.time_ns
        yield from _along(others, None, last_ns)

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
