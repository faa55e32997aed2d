"""Health of live localization: missing input, skipped images, latencies."""

from __future__ import annotations

import re
import time
from collections import deque
from collections.abc import Collection

import numpy as np

from sequences.live.reader import LiveReader
from sequences.reading.counts import OVERTAKEN
from vapor.robot.belief import Anchor, LiveBelief
from vapor.robot.recorder import MessageRecorder

_SILENT_S, _CAMERA_SILENT_S = 1.0, 5.0  # of all images, and of one camera among several
_ODOMETRY_SILENT_S = 0.5
_LATENCIES = 1000
_REFUSED = "refused"
_NUMBER = re.compile(r"[+-]?\d+(\.\d+)?")
_USUAL = (OVERTAKEN, _REFUSED)
_APART, _ENOUGH_IMAGES = "images and odometry are by different clocks", 10


class Health:
    """Counts and latencies, and the times of the last messages; without a belief until topics are found."""

    def __init__(self) -> None:
        self.belief: LiveBelief | None = None
        self.recorder: MessageRecorder | None = None
        self.localized = self.refused = 0
        self._image_s = self._odometry_s = time.monotonic()
        self._images_s: dict[str, float] = {}  # by camera
        self._left_out: set[str] = set()
        self._latencies_ms: deque[float] = deque(maxlen=_LATENCIES)
        self._noticed: set[str] = set()

    @property
    def reader(self) -> LiveReader | None:
        """Who reads the topics; None until they are found."""
        return None if self.belief is None else self.belief.reader

    def image_came(self, camera: str) -> None:
        """Note an image, used or not."""
        self._image_s = self._images_s[camera] = time.monotonic()

    def left_out(self, cameras: Collection[str]) -> None:
        """Note cameras whose latest image did not count."""
        self._left_out |= set(cameras)

    def odometry_came(self) -> None:
        """Note later odometry."""
        self._odometry_s = time.monotonic()

    def image_was_localized(self, latency_ms: float) -> None:
        """Count a localized image."""
        self.localized += 1
        self._latencies_ms.append(latency_ms)

    @property
    def skipped(self) -> dict[str, int]:
        """Number of images that were left out, by reason."""
        skipped = {} if self.reader is None else dict(self.reader.counts.skipped)
        return skipped | ({_REFUSED: self.refused} if self.refused else {})

    @property
    def has_odometry(self) -> bool:
        """Whether odometry is current."""
        return time.monotonic() - self._odometry_s < _ODOMETRY_SILENT_S

    def is_old(self, anchor: Anchor) -> bool:
        """Whether images are missing since the last localized one."""
        return anchor.age_s > _SILENT_S

    def silent(self, anchor: Anchor | None) -> str | None:
        """The missing input, in words; None where nothing is missing."""
        now_s = time.monotonic()
        if self.reader is None:
            return None
        if self.reader.has_odometry and now_s - self._odometry_s > _SILENT_S:
            return f"no odometry for {now_s - self._odometry_s:.0f} s"
        if now_s - self._image_s > _SILENT_S:
            return f"no image for {now_s - self._image_s:.0f} s"
        if anchor is not None and self.is_old(anchor):
            return f"no image that can be used for {anchor.age_s:.0f} s"
        return None

    def values(self) -> dict[str, object]:
        """Counts and times for diagnostics, by name."""
        values: dict[str, object] = {}
        if self.belief is not None and self.reader is not None:
            values = {"images": self.reader.counts.read, "images localized": self.localized}
            values |= {f"images skipped, {why}": n for why, n in sorted(self.skipped.items())}
            values |= {f"messages left out, {why}": n for why, n in sorted(self.reader.skipped_messages.items())}
            values |= self.reader.sensors.values(self.belief.frames.gravity)
        if self._latencies_ms:
            median, late = np.percentile(self._latencies_ms, [50, 99])
            values |= {"latency, median, ms": f"{median:.1f}", "latency, 99 %, ms": f"{late:.1f}"}
        if self.recorder is not None:
            values |= {"messages recorded": self.recorder.number, "messages not recorded": self.recorder.lost}
        return values

    def notices(self) -> list[str]:
        """Notices for a person, each once: reasons of skipped input, camera, clocks and recording."""
        belief, reader = self.belief, self.reader
        assert belief is not None
        assert reader is not None
        notices = {
            reason: f"left out: {reason}{reader.problems.get(reason, '')}"
            for reason in [*self.skipped, *reader.skipped_messages]
            if reason not in _USUAL
        }
        told = [notice for lens in reader.lenses.values() for notice in lens.notices]
        told += [*reader.notices, *reader.sensors.notices, *belief.verticals.notices, *belief.frames.notices]
        notices |= {_NUMBER.sub("0", notice): notice for notice in told}  # other figures are no news
        now_s = time.monotonic()
        for name in reader.lenses if len(reader.lenses) > 1 and now_s - self._image_s < _SILENT_S else ():
            if now_s - self._images_s.setdefault(name, now_s) > _CAMERA_SILENT_S:
                notices[f"silent {name}"] = f"no image of {name} for {_CAMERA_SILENT_S:g} s: the other cameras go on"
        for name in self._left_out:
            notices[f"left out {name}"] = (
                f"images of {name} are left out, as they fit nowhere where those of the other cameras fit: expected its"
                " mount (tf), intrinsics and clock to be right, and a clean lens"
            )
        if self.recorder is not None and self.recorder.error is not None:
            notices[self.recorder.error] = self.recorder.error
        if reader.apart is not None and reader.counts.read > _ENOUGH_IMAGES:
            notices[_APART] = f"{_APART}: {reader.apart}"
        new = [text for reason, text in notices.items() if reason not in self._noticed]
        self._noticed |= set(notices)
        return new
