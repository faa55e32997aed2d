"""A video file, a folder of images or a data set -> frames without odometry."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import fields
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import UInt8

from filtering.errors import VaporTrackError, counted
from filtering.se3 import Poses
from sequences.datasets.layout import PosedImages
from sequences.datasets.layout_helpers.image_files import decoded_file, find_camera, images_in, size_of_first
from sequences.datasets.layout_helpers.packed import VIDEO_SUFFIXES, VideoFile
from sequences.datasets.listing import clipped, found_images, is_recording, list_images, none_among, what_is_there
from sequences.errors import SequenceError
from sequences.files import Rows
from sequences.frame import ASSUMED_HZ, Camera, Frame
from sequences.images.headers import why_skipped
from sequences.images.undistortion import Lens, as_used, pinhole_of, same_aspect, undistorted
from sequences.options import OdometryOrigin, SequenceOptions
from sequences.reading.counts import NOT_INCREASING, OUTSIDE, ImageCounts
from sequences.reading.frame_pairing import RequestedSegment
from sequences.recordings.recording_file import SUFFIXES
from sequences.trajectories.pose_lines import stamp_ns, stamp_of
from sequences.values import natural

_USED = frozenset({"undistort", "start_s", "duration_s", "allow_few_images"})  # options that apply
_READABLE = 0.95  # of the frames that a video states: some formats state a few too many
_RATES_HZ = 1e-3, 1e6
_Image = UInt8[np.ndarray, "height width 3"]


class _Dated(NamedTuple):
    """An image that can be read: `decode` gives it, or the reason why it cannot be used."""

    time_ns: int
    decode: Callable[[], _Image | str]
    lens: Camera | Lens | None
    pose: Poses | None = None


def is_image_sequence(path: Path) -> bool:
    """Whether a path is a video file by its name, a list or archive of a data set, or a folder without a recording."""
    if not path.is_dir():
        return path.suffix.lower() in VIDEO_SUFFIXES or (path.is_file() and not is_recording(path))
    recorded = (path / "metadata.yaml").is_file() or any(file.suffix.lower() in SUFFIXES for file in path.iterdir())
    return not recorded


class ImageSequence:
    """Frames of a video file, a folder of images or a data set, read as a stream; every iteration reads them again.

    Frames of a video have its time stamps, and are as a player shows them, turned by its metadata. Images of a folder
    are as they are stored, in the order of the stamps that all their names state (`1305031102.175304.png`), or else of
    their names, so many a second. Intrinsics are those of an `intrinsics.json` in the folder of the video or of the
    images, or in the one above; they are of images of any size, but of the same aspect ratio.

    Images of a data set have the true poses, stamps and intrinsics that its files state, as for `posed_frames`; images
    without a true pose are left out.

    Attributes:
        path: The file or folder.
        counts: Counts of the images of the latest iteration; complete after it.
        notices: Sentences for users; complete after an iteration.
        camera: Intrinsics of the undistorted images; None where they are not stated.
        odometry_origin: None.
        no_odometry: Empty: none is expected.
        has_stamps: Whether the time stamps of the images are stated; else their rate is assumed.
        num_images: Images in all, or in the part, for progress; 0 where a video does not state it.
        image_description, odometry_description: None: no file states them.

    Example:
        >>> import vapor
        >>> images = vapor.ImageSequence("images/", rate_hz=10.0)  # or a video
        >>> for frame in images:
        ...     frame.image.shape, frame.odometry
        ((32, 48, 3), None)
        ((32, 48, 3), None)
    """

    odometry_origin: OdometryOrigin | None = None
    no_odometry: str = ""
    image_description: str | None = None
    odometry_description: str | None = None

    def __init__(
        self,
        path: Path | str,
        options: SequenceOptions | None = None,
        *,
        rate_hz: float = float(ASSUMED_HZ),
        frames: slice = slice(None),
    ) -> None:
        """Open a video or a folder.

        Args:
            path: Video file, folder with PNG or JPEG images, or a data set of one sequence, as `list_images` takes it.
            options: What to read. Those of topics, odometry and true poses do not apply.
            rate_hz: How many images there are in a second, in a folder of images or a data set that states no stamps.
            frames: Which of the images, counted from 0; neither from the end nor in steps.

        Raises:
            SequenceError: no such video, images or list, a damaged data set or one of several sequences, a damaged
                `intrinsics.json`, one of another aspect ratio, or options that do not apply.
        """
        self.path, self._options, self._rate_hz = Path(path), options or SequenceOptions(), rate_hz
        self._part = frames
        _require_applicable(self.path, self._options)
        if not _RATES_HZ[0] <= rate_hz <= _RATES_HZ[1]:
            raise VaporTrackError(f"rate_hz is {rate_hz}, expected between {_RATES_HZ[0]:g} and {_RATES_HZ[1]:g}")
        self._posed = _data_set(self.path)
        self._files = images_in(self.path) if self._posed is None else []
        self._dates = _stamps(self._files)
        self.has_stamps = not self._files or self._dates is not None
        if self._posed is not None:
            lens = next((lens for lens in self._posed.cameras if lens is not None), None)
            self.has_stamps, self.num_images = self._posed.assumed_hz is None, len(self._posed)
        elif self.path.is_dir():
            if not self._files:
                raise SequenceError(f"{path}: {what_is_there(self.path, images=True)}")
            lens = self._find_lens(self.path, size_of_first(self._files))
            self.num_images = len(self._files)
        else:
            video = VideoFile(self.path, upright=True)
            lens = self._find_lens(self.path.parent, (video.width, video.height))
            self.num_images = video.num_frames or 0
        self.num_images = len(range(self.num_images)[frames])
        self._lens = as_used(lens, undistort=self._options.undistort)
        self.camera: Camera | None = None if self._lens is None else pinhole_of(self._lens)
        self.counts = ImageCounts(self.num_images)
        self.notices: list[str] = []

    def _find_lens(self, folder: Path, size: tuple[int, int] | None) -> Camera | Lens | None:
        lens = find_camera([folder, folder.parent], [])
        if lens is None or size is None:
            return lens
        stated = lens.camera if isinstance(lens, Lens) else lens
        if not same_aspect(stated, *size):
            raise SequenceError(
                f"{self.path}: intrinsics.json is of {stated.width} x {stated.height} pixels, the images are of"
                f" {size[0]} x {size[1]}; expected the same aspect ratio (a video's frames are as a player shows them)"
            )
        return lens.scaled(*size)

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
            SequenceError: no frame of the video can be read, more than half of the images of a folder cannot be
                decoded, or no image is left.
        """
        options = self._options
        self.counts = counts = ImageCounts(0)
        self.notices = []
        first, stop = self._part.start or 0, np.inf if self._part.stop is None else self._part.stop
        segment: RequestedSegment | None = None
        latest_ns: int | None = None
        num_there = num_unlike = 0
        for number, (time_ns, decode, lens, pose) in enumerate(self._dated()):
            if number >= stop:
                break
            num_there = number + 1
            if number < first:
                continue
            counts.read += 1
            counts.stated += 1
            segment = segment or RequestedSegment(time_ns, options.start_s, options.duration_s)
            if latest_ns is not None and time_ns <= latest_ns:
                counts.skipped[NOT_INCREASING] += 1
                continue
            latest_ns = time_ns
            if segment.ends_before(time_ns):
                counts.skipped[OUTSIDE] += 1
                segment.is_stopped = True
                break
            if not segment.has(time_ns):
                counts.skipped[OUTSIDE] += 1
                continue
            image = decode()
            if isinstance(image, str):
                counts.skipped[image] += 1
                continue
            counts.used += 1
            image, camera = self._undistorted(image, lens)
            num_unlike += camera is None and self.camera is not None
            yield Frame(time_ns, image, None, pose, camera, number=number)
        counts.skipped[OUTSIDE] += (unread := max(self.num_images - counts.stated, 0) if _stopped(segment) else 0)
        counts.stated += unread
        counts.skipped = +counts.skipped
        if segment is None and num_there:
            raise SequenceError(f"{self.path}: {none_among(self._part, num_there, posed=self._posed is not None)}")
        if not counts.used:
            found = ", ".join(f"{count} × {reason}" for reason, count in counts.skipped.items()) or "none was read"
            late = None if segment is None or latest_ns is None else segment.begins_after(latest_ns)
            expected = late or "expected at least one that can be used"
            raise SequenceError(f"{self.path}: no image is left: {found}; {expected}")
        if not _stopped(segment) and (fewer := clipped(self._part, num_there)) is not None:
            self.notices.append(fewer)
        self._judge(num_unlike, whole=not _stopped(segment))

    def _judge(self, num_unlike: int, *, whole: bool) -> None:
        """Add the notices of the reading."""
        if self.camera is None:
            self.notices.append(
                "no intrinsics, expected an intrinsics.json beside the images; the camera of the training images is"
                " assumed"
            )
        if num_unlike:
            self.notices.append(
                f"intrinsics of {counted(num_unlike, 'image')} of another aspect ratio than the first are unknown"
            )
        if whole and self.counts.read < _READABLE * self.num_images:
            self.notices.append(
                f"the video states {counted(self.num_images, 'frame')}, and {self.counts.read} could be read: it is"
                " damaged or cut off"
            )

    def _undistorted(self, image: _Image, lens: Camera | Lens | None) -> tuple[_Image, Camera | None]:
        try:
            return undistorted(image, lens)
        except SequenceError as error:
            raise SequenceError(f"{self.path}: {error}") from error

    def _dated(self) -> Iterator[_Dated]:
        """Each image with its stamp, intrinsics and true pose."""
        rows = Rows("images", why_skipped)
        if self._posed is not None:
            yield from self._of_data_set(self._posed, rows)
        else:
            for time_ns, decode in self._listed() if self._files else VideoFile(self.path, upright=True).frames():
                yield _Dated(time_ns, partial(_decoded, rows, decode), self._lens)
        rows.require_few()
        self.notices += rows.notices

    def _of_data_set(self, posed: PosedImages, rows: Rows) -> Iterator[_Dated]:
        """The images of a data set, likewise."""
        self.notices += posed.notices
        self.notices += [f"{number} left out of the data set: {reason}" for reason, number in posed.skipped.items()]
        times_ns = posed.times_ns.tolist()
        if posed.assumed_hz is not None:
            times_ns = [int(round(1e-9 * at * posed.assumed_hz) * 1e9 // self._rate_hz) for at in times_ns]
            self.notices.append(f"no time stamps: {self._rate_hz:g} images a second are assumed (--rate-hz)")
        for i, file in enumerate(posed.files):
            lens = as_used(posed.cameras[i], undistort=self._options.undistort)
            decode = partial(_decoded, rows, partial(decoded_file, file))
            yield _Dated(times_ns[i], decode, lens, posed.world_from_camera[i])

    def _listed(self) -> Iterator[tuple[int, Callable[[], _Image]]]:
        """The images of a folder, likewise."""
        dates = self._dates
        if dates is None:
            self.notices.append(
                f"not all names of the images state time stamps: {self._rate_hz:g} images a second are assumed"
                " (--rate-hz)"
            )
            ordered = sorted(self._files, key=lambda file: natural(file.name))
            dates = [(round(1e9 * number / self._rate_hz), file) for number, file in enumerate(ordered)]
        for time_ns, file in dates:
            yield time_ns, partial(decoded_file, file)


def _data_set(path: Path) -> PosedImages | None:
    """The images of a data set of one sequence; None of videos, and of images without true poses in a folder."""
    if path.suffix.lower() in VIDEO_SUFFIXES and not path.is_dir():
        return None
    posed = found_images(path) if path.is_dir() else list_images(path)
    if posed is None or not len(posed):
        return None
    if posed.has_several:
        count = len(np.unique(np.asarray(posed.sequence)))
        raise SequenceError(f"{path}: {count} sequences, expected one at a time, such as the folder of one of them")
    return posed


def _decoded(rows: Rows, decode: Callable[[], _Image]) -> _Image | str:
    rows.num_rows += 1
    return rows.use(decode)


def _stopped(segment: RequestedSegment | None) -> bool:
    return segment is not None and segment.is_stopped


def _stamps(files: list[Path]) -> list[tuple[int, Path]] | None:
    """Nanoseconds that the names of all images state, in order; None where one states none."""
    if not all(stamp_of(file.name) is not None for file in files):
        return None
    return sorted((stamp_ns(file.name, str(file)), file) for file in files)


def _require_applicable(path: Path, options: SequenceOptions) -> None:
    usual = SequenceOptions()
    given = [
        f"--{each.name.replace('_', '-')}"
        for each in fields(options)
        if each.name not in _USED and getattr(options, each.name) != getattr(usual, each.name)
    ]
    if given:
        raise SequenceError(f"{path}: {', '.join(given)} with images alone, expected a recording with topics for them")
