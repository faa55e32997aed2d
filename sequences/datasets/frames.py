"""Frames with true poses, of a recording or of a data set: the one entry for training."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import count, islice
from pathlib import Path

from sequences.datasets.layout import PosedImages
from sequences.datasets.layout_helpers.image_files import decoded_file
from sequences.datasets.listing import as_typed, clipped, is_recording, list_images, none_among
from sequences.datasets.points import SeenPoints
from sequences.errors import NoImageError, SequenceError
from sequences.files import Rows
from sequences.frame import Camera, Frame
from sequences.images.headers import why_skipped
from sequences.images.undistortion import as_used, pinhole_of, undistorted
from sequences.options import OdometryUse, SequenceOptions
from sequences.reader import SequenceReader


class PosedFrames(Iterator[Frame]):
    """Frames with true poses, from `posed_frames`.

    Attributes:
        skipped: Images and poses of the data that were left out, by reason; complete once all frames were yielded.
        notices: Remarks on the true poses, likewise.
        camera_names: Names of the cameras of a recording, once its first frame was yielded or its cameras were asked
            for; empty of a data set.
    """

    def __init__(
        self,
        path: Path,
        frames: slice,
        options: SequenceOptions | None,
        odometry: OdometryUse,
        usual_cameras: Sequence[str] = (),
    ) -> None:
        self.skipped: Counter[str] = Counter()
        self.notices: list[str] = []
        self.camera_names: tuple[str, ...] = ()
        self._path, self._slice, self._options = path, frames, options
        self._odometry: OdometryUse = odometry
        self._usual_cameras = usual_cameras
        self._source: SequenceReader | PosedImages | None = None
        self._known: int | None = None  # images with a true pose, of any one camera, once they are counted
        self._frames = self._read()

    def __next__(self) -> Frame:
        return next(self._frames)

    def _read(self) -> Iterator[Frame]:
        is_empty = True
        for frame in self._recorded() if is_recording(self._path) else self._listed():
            is_empty = False
            yield frame
        if is_empty:
            raise SequenceError(f"{self._path}: {none_among(self._slice, self._known)}")
        if self._known is not None and (fewer := clipped(self._slice, self._known)) is not None:
            self.notices.append(f"{self._path}: {fewer}")

    def _recorded(self) -> Iterator[Frame]:
        """Frames of a recording; without odometry where the frame before was left out."""
        reader = self._open()
        assert isinstance(reader, SequenceReader)
        if len(self.camera_names) == 1:
            yield from self._of_camera(reader)
            return
        unusable: list[NoImageError] = []
        for name in self.camera_names:  # the frames of each together, as a camera of its own
            try:
                yield from map(as_its_own, self._of_camera(self._reader(only_camera=name)))
            except NoImageError as error:
                unusable.append(error)
                self.notices.append(f"{name} is left out: {error}")
        if len(unusable) == len(self.camera_names):
            raise unusable[0]

    def _of_camera(self, reader: SequenceReader) -> Iterator[Frame]:
        begin, end, step = self._slice.start, self._slice.stop, self._slice.step
        if any(bound is not None and bound < 0 for bound in (begin, end, step)):
            raise SequenceError(
                f"{self._path}: frames {as_typed(self._slice)} count from the end, which a stream does not know;"
                " expected numbers from 0 on"
            )
        counter = count()
        posed = (frame for frame, _ in zip(_posed(reader, self.skipped), counter, strict=False))
        for taken, frame in enumerate(islice(posed, begin, end, step)):
            follows = taken > 0 and step in (None, 1)
            number = (begin or 0) + taken * (step or 1)
            yield replace(frame, odometry=frame.odometry if follows else None, number=number)
        if end is None or (begin or 0) < end:  # where nothing was yielded, all were read
            self._known = max(self._known or 0, next(counter))
        reader.stop()
        for _ in posed:  # none comes any more
            pass
        # Messages beside the images are those of each camera.
        first = reader.camera_names[0] == self.camera_names[0]
        self.skipped.update(reader.skipped if first else reader.counts.skipped)
        if reader.across_jumps:
            self.skipped["true pose jumps"] += reader.across_jumps
            self.skipped["no true pose"] -= reader.across_jumps
            if not self.skipped["no true pose"]:
                del self.skipped["no true pose"]
        few = [reader.counts.warning] if reader.counts.warning else []
        said = [f"{self._path}: {notice}" for notice in [*reader.notices, *few]]
        self.notices += [notice for notice in said if notice not in self.notices]

    def _listed(self) -> Iterator[Frame]:
        """Frames of images on disk; those that cannot be decoded are left out, unless it is most of them."""
        source = self._open()
        assert isinstance(source, PosedImages)
        self.skipped.update(source.skipped)
        self._known = len(source)
        images, rows = source[self._slice], Rows("images", why_skipped)
        numbers = range(len(source))[self._slice]
        undistort = self._options is None or self._options.undistort
        for i, file in rows.each(enumerate(images.files)):
            image = rows.use(decoded_file, file)
            if isinstance(image, str):
                self.skipped[image] += 1
                continue
            try:
                image, camera = undistorted(image, as_used(images.cameras[i], undistort=undistort))
            except SequenceError as error:
                raise SequenceError(f"{file}: {error}") from error
            sequence = 0 if images.sequence is None else int(images.sequence[i])
            pose = images.world_from_camera[i]
            yield Frame(int(images.times_ns[i]), image, None, pose, camera, sequence, number=numbers[i])
        self.notices += [*images.notices, *rows.notices]

    def _open(self) -> SequenceReader | PosedImages:
        if self._source is None and is_recording(self._path):
            self._source = self._reader()
            self.camera_names = self._source.camera_names
        elif self._source is None:
            self._source = list_images(self._path)
        return self._source

    def _reader(self, only_camera: str | None = None) -> SequenceReader:
        return SequenceReader(
            self._path,
            self._options,
            odometry=self._odometry,
            true_poses="required",
            usual_cameras=self._usual_cameras,
            only_camera=only_camera,
        )

    def cameras(self) -> Counter[Camera]:
        """How many images are of which camera, undistorted; of a recording all of its images, whether used or not.

        Raises SequenceError as the first frame would.
        """
        source = self._open()
        if isinstance(source, SequenceReader):
            return source.cameras()
        undistort = self._options is None or self._options.undistort
        known = [as_used(camera, undistort=undistort) for camera in source[self._slice].cameras]
        return Counter(pinhole_of(camera) for camera in known if camera is not None)

    def seen_points(self) -> dict[int, SeenPoints]:
        """Which points of a reconstruction the images show, by their stamps; none where the data have none.

        Raises SequenceError as the first frame would, and where the points are damaged.
        """
        source = self._open()
        if isinstance(source, SequenceReader) or source.read_points is None:
            return {}
        points = source.read_points(self._options is None or self._options.undistort)
        self.notices += points.notices
        images = source[self._slice]
        stamps = zip(images.times_ns.tolist(), images.files, strict=True)
        return {time_ns: points.of[file] for time_ns, file in stamps if file in points.of}


def as_its_own(frame: Frame) -> Frame:
    """A frame of one of several cameras as if that were the one that is localized; of frames of that camera alone."""
    mount, odometry = frame.reference_from_camera, frame.odometry
    if mount is not None and odometry is not None:
        odometry = odometry.of_another_frame(mount)
    return replace(frame, odometry=odometry, reference_from_camera=None)


def posed_frames(
    path: Path,
    *,
    frames: slice = slice(None),
    options: SequenceOptions | None = None,
    odometry: OdometryUse = "optional",
    usual_cameras: Sequence[str] = (),
) -> PosedFrames:
    """Frames with true poses, in order of time; MCAP sequences with their odometry, where there is any to be found.

    Args:
        path: MCAP file, rosbag2 folder, or a data set as `list_images` takes it.
        frames: Which of them; for MCAP, of those with a true pose, and not counted from the end.
        options: What to read of an MCAP sequence, and where its true poses are; of that, folders of images heed
            `undistort` only.
        odometry: Whether that of an MCAP sequence is read; without it reading takes a quarter of the time.
        usual_cameras: Topics of cameras of a recording that are read where there are several and none is named.

    Raises:
        SequenceError: the layout is unknown, a file is missing or damaged, or no frame is left; with the first frame.
    """
    return PosedFrames(Path(path), frames, options, odometry, usual_cameras)


def _posed(frames: Iterable[Frame], skipped: Counter[str]) -> Iterator[Frame]:
    """Those with a true pose; without odometry where the frame before was left out."""
    follows = True
    for frame in frames:
        if frame.world_from_camera is not None:
            yield frame if follows else replace(frame, odometry=None)
        else:
            skipped["no true pose"] += 1
        follows = frame.world_from_camera is not None
