"""A video file or a folder of images -> frames: images alone, without odometry and true poses."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8

from sequences.datasets.layout_helpers.image_files import decoded_file, find_camera, images_in
from sequences.datasets.layout_helpers.packed import VideoFile
from sequences.errors import SequenceError
from sequences.files import Rows
from sequences.frame import Camera, Frame
from sequences.images.headers import why_skipped
from sequences.images.undistortion import Lens, pinhole_of, undistorted
from sequences.options import SequenceOptions
from sequences.reading.counts import OUTSIDE, ImageCounts
from sequences.recordings.recording_file import SUFFIXES
from sequences.trajectories.pose_lines import stamp_ns, stamp_of
from sequences.values import natural

VIDEO_SUFFIXES = (".mp4", ".mov", ".m4v", ".mkv", ".avi", ".webm")
"""Of video files."""

_USED = frozenset({"undistort", "start_s", "duration_s", "rate_hz", "allow_few_images"})  # options that apply
_NOT_INCREASING = "time stamp not increasing"
_Dated = tuple[int, UInt8[np.ndarray, "height width 3"] | str]


def is_image_sequence(path: Path) -> bool:
    """Whether a path is a video file by its name, or a folder with images and without a recording in it."""
    if not path.is_dir():
        return path.suffix.lower() in VIDEO_SUFFIXES
    return bool(images_in(path)) and not any(file.suffix in SUFFIXES for file in path.iterdir())


class ImageSequence:
    """Frames of a video file or of a folder of images, read as a stream; every iteration reads them again.

    Frames of a video have its time stamps, and are as a player shows them, turned by its metadata. Images of a folder
    are in the order of their names, with the stamps that their names state (`1305031102.175304.png`), or so many a
    second. Intrinsics are those of an `intrinsics.json` beside the video or the images, of any size of the image.

    Attributes:
        path: The file or folder.
        counts: Counts of the images of the latest iteration; complete after it.
        notices: Sentences for users; complete after an iteration.
        camera: Intrinsics of the undistorted images; None where they are not stated.
        has_odometry: False.
        num_images: Images in all, for progress; 0 where a video does not state it.
        image_description, odometry_description: None: no file states them.
    """

    has_odometry = False
    image_description: str | None = None
    odometry_description: str | None = None

    def __init__(self, path: Path, options: SequenceOptions | None = None) -> None:
        """Open a video or a folder.

        Args:
            path: Video file, or folder with PNG or JPEG images.
            options: What to read. Those of topics, odometry and true poses do not apply.

        Raises:
            SequenceError: no such video or images, a damaged `intrinsics.json`, or options that do not apply.
        """
        self.path, self._options = path, options or SequenceOptions()
        _require_applicable(path, self._options)
        self._files = sorted(images_in(path), key=lambda file: natural(file.name)) if path.is_dir() else []
        if path.is_dir():
            if not self._files:
                raise SequenceError(f"{path}: no images, expected PNG or JPEG files in the folder")
            self._lens = find_camera([path, path.parent], self._files)
            self.num_images = len(self._files)
        else:
            video = VideoFile(path, upright=True)
            described = find_camera([path.parent], [])
            self._lens = None if described is None else described.scaled(video.width, video.height)
            self.num_images = video.num_frames or 0
        if not self._options.undistort and isinstance(self._lens, Lens):
            self._lens = self._lens.camera
        self.camera: Camera | None = None if self._lens is None else pinhole_of(self._lens)
        self.counts = ImageCounts(self.num_images)
        self.notices: list[str] = []

    @property
    def skipped(self) -> Counter[str]:
        """How many images of the latest iteration were left out, by reason."""
        return self.counts.skipped

    @property
    def resolved(self) -> dict[str, Any]:
        """Options that were found: none."""
        return {}

    def __iter__(self) -> Iterator[Frame]:
        """Frames in order of time.

        Raises:
            SequenceError: the video is damaged before its first frame, more than half of the images of a folder cannot
                be decoded, images do not fit the intrinsics, or no image is left.
        """
        options = self._options
        self.counts = counts = ImageCounts(0)
        self.notices = [] if self.camera is not None else [_no_intrinsics(self.path)]
        begin_ns: int | None = None
        latest_ns: int | None = None
        for time_ns, image in self._dated():
            counts.read += 1
            counts.stated += 1
            begin_ns = time_ns if begin_ns is None else begin_ns
            since_s = (time_ns - begin_ns) * 1e-9
            if since_s < options.start_s or (options.duration_s or np.inf) < since_s - options.start_s:
                counts.skipped[OUTSIDE] += 1
            elif isinstance(image, str):
                counts.skipped[image] += 1
            elif latest_ns is not None and time_ns <= latest_ns:
                counts.skipped[_NOT_INCREASING] += 1
            else:
                latest_ns = time_ns
                counts.used += 1
                image, camera = self._undistorted(image)
                yield Frame(time_ns, image, None, None, camera)
        if not counts.used:
            found = ", ".join(f"{count} × {reason}" for reason, count in counts.skipped.items()) or "none was read"
            raise SequenceError(f"{self.path}: no image is left: {found}; expected at least one that can be used")

    def _undistorted(self, image: UInt8[np.ndarray, "h w 3"]) -> tuple[UInt8[np.ndarray, "h w 3"], Camera | None]:
        try:
            return undistorted(image, self._lens)
        except SequenceError as error:
            raise SequenceError(f"{self.path}: {error}") from error

    def _dated(self) -> Iterator[_Dated]:
        """Each image with its stamp, or the reason why it cannot be used."""
        if not self._files:
            yield from VideoFile(self.path, upright=True).frames()
            return
        rows, stamps = Rows("images", why_skipped), self._stamps()
        for time_ns, file in rows.each(zip(stamps, self._files, strict=True)):
            yield time_ns, rows.use(decoded_file, file)
        self.notices += rows.notices

    def _stamps(self) -> list[int]:
        """Of the images of a folder, nanoseconds."""
        if all(stamp_of(file.name) is not None for file in self._files):
            return [stamp_ns(file.name, str(file)) for file in self._files]
        rate_hz = self._options.rate_hz
        self.notices.append(
            f"the names of the images state no time stamps: {rate_hz:g} images a second are assumed (--rate-hz)"
        )
        return [round(1e9 * number / rate_hz) for number in range(len(self._files))]


def _no_intrinsics(path: Path) -> str:
    return (
        f"{path}: no intrinsics, expected an intrinsics.json beside the images; the camera of the training images is"
        " assumed"
    )


def _require_applicable(path: Path, options: SequenceOptions) -> None:
    usual = SequenceOptions()
    given = [
        f"--{each.name.replace('_', '-')}"
        for each in fields(options)
        if each.name not in _USED and getattr(options, each.name) != getattr(usual, each.name)
    ]
    if given:
        raise SequenceError(f"{path}: {', '.join(given)} with images alone, expected a recording with topics for them")
