"""Frames with true poses -> a training set: scaled, of one camera, in a nameless temporary file."""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import IO, NamedTuple

import numpy as np
from jaxtyping import UInt8

from filtering.motion import Odometry
from filtering.se3 import Poses
from sequences.datasets.frames import PosedFrames
from sequences.datasets.points import POINTS_OF_A_MODEL, SeenPoints
from sequences.frame import Camera, Frame
from vapor.cameras import AsTakenBy, described
from vapor.images import centre_crop, scale_to_cover
from vapor.landmarks.build import VIEW_PX
from vapor.landmarks.verify import grey_view
from vapor.training_data.checks import Colours, said_of_colours, too_far
from vapor.training_data.training_set import TrainingError, TrainingSet
from vapor.training_data.views import Views, said_of_views

_MOST_CAMERAS = 3  # in a notice
_USUAL_FOCAL = 0.8  # of the longer edge, where no focal length is stated: about 64° wide


def load_training_set(
    sequences: Mapping[str, Iterable[Frame]],
    frame_size: tuple[int, int] | Callable[[int, int], tuple[int, int]],
    *,
    central: bool = True,
    camera: Camera | None = None,
    views: bool = False,
    view_camera: Camera | None = None,
    progress: Callable[[int], None] = lambda _: None,
) -> TrainingSet:
    """Read frames once, scale each image to cover a frame, and keep it in a temporary file.

    Args:
        sequences: Frames by the name of their file or folder; frames without a pose are skipped.
        frame_size: Width and height of the frame, pixels, or a function of the camera's width and height.
        central: Keep the middle that fills the frame, so that images may differ in size; else keep whole images, which
            must all have the aspect ratio of the first one.
        camera: The camera to which images with known intrinsics are resampled; None for the camera of most images.
        views: Keep grey and larger images, too, for landmarks.
        view_camera: The camera of these; None for the camera of most images.
        progress: Called with the number of images read so far.

    Raises:
        TrainingError: a sequence without posed frames, a pose that is not finite, or images of different aspect.
    """
    rows: list[_Row] = []
    skipped: Counter[str] = Counter()
    notices: list[str] = []
    colours: dict[str, Colours] = {}
    cameras, topics = {"": 0}, dict[str, None]()
    shape: tuple[int, ...] | None = None
    camera = camera or commonest_camera(sequences)
    camera_size = (camera.width, camera.height) if camera else None
    as_taken: AsTakenBy | None = None
    with tempfile.TemporaryFile() as file, tempfile.TemporaryFile() as grey_file:
        grey = GreyViews(view_camera or camera, grey_file) if views else None
        for index, (name, frames) in enumerate(sequences.items()):
            follows = False
            num_before, agreeing = len(rows), Views()
            given = frames.seen_points() if views and isinstance(frames, PosedFrames) else {}
            colours[name] = Colours()
            for frame in frames:
                agreeing.take(frame)
                if frame.world_from_camera is None:
                    follows = False
                    continue
                if as_taken is None or camera_size is None:  # the first image
                    camera_size = camera_size or (frame.image.shape[1], frame.image.shape[0])
                    size = frame_size(*camera_size) if callable(frame_size) else frame_size
                    as_taken = AsTakenBy(camera, size)
                image = scale_to_cover(as_taken(frame.image, frame.camera), *as_taken.frame_size)
                image = centre_crop(image, *as_taken.frame_size) if central else image
                shape = shape or image.shape
                if image.shape != shape:
                    number = len(rows) - num_before + 1
                    raise TrainingError(
                        f"{name}: image {number}, at {frame.time_ns} ns, is {image.shape[1]} x {image.shape[0]} after"
                        f" scaling, expected {shape[1]} x {shape[0]} as the first (or augment.crop central)"
                    )
                if not frame.world_from_camera.is_finite():
                    raise TrainingError(f"{name}: true pose at {frame.time_ns} ns is not finite")
                colours[name].take(frame.image)
                file.write(np.ascontiguousarray(image).data)
                if grey is not None:
                    grey.take(frame)
                of_image = given.pop(frame.time_ns, None) if frame.camera is not None else None
                points = of_image and replace(of_image, point=of_image.point + index * POINTS_OF_A_MODEL)
                step = frame.odometry if follows else None
                source = index, frame.sequence, cameras.setdefault(frame.camera_name, len(cameras))
                rows.append(_Row(source, frame.time_ns, frame.world_from_camera, step, points, frame.number))
                follows = True
                progress(len(rows))
            if len(rows) == num_before:
                raise TrainingError(f"{name}: no image with a true pose, expected at least one")
            if isinstance(frames, PosedFrames):
                skipped += frames.skipped
                notices += frames.notices
                topics |= dict.fromkeys(frames.camera_names)
            notices += said_of_views(name, agreeing.checks())
        if shape is None or camera_size is None or as_taken is None:
            raise TrainingError("no training data, expected at least one sequence")
        file.flush()
        images = np.memmap(file, np.uint8, mode="r", shape=(len(rows), *shape))
        kept, view_camera = (grey.kept(), grey.camera) if grey else (np.zeros((0, 1, 1), np.uint8), None)
    sources, points = [row.source for row in rows], tuple(row.points for row in rows)
    poses = Poses.stack([row.pose for row in rows])
    counted = [row.number for row in rows if row.number is not None]
    notices += said_of_colours(colours)
    notices += [*_of_cameras(as_taken, len(sources)), *too_far(poses)]
    begins = np.any(np.diff(np.array(sources), axis=0, prepend=[sources[0]]) != 0, axis=1)
    begun = [sources[i] for i in [0, *np.flatnonzero(begins)]]
    walks = {source[:2]: number for number, source in enumerate(dict.fromkeys(each[:2] for each in begun))}
    return TrainingSet(
        images,
        np.arange(len(rows)),
        poses,
        np.cumsum(begins),
        _sequence_names(list(sequences), begun, list(cameras)),
        camera_size,
        np.array([row.time_ns for row in rows], np.int64),
        tuple(row.odometry for row in rows),
        skipped,
        tuple(notices),
        as_taken.camera,
        kept,
        view_camera,
        points if any(points) else (),
        tuple(walks[source[:2]] for source in begun),
        tuple(topics),
        np.array(counted, np.int64) if len(counted) == len(rows) else None,
    )


class _Row(NamedTuple):
    source: tuple[int, int, int]  # numbers of the file or folder, of the sequence in it, and of the camera
    time_ns: int
    pose: Poses
    odometry: Odometry | None
    points: SeenPoints | None
    number: int | None


def commonest_camera(sequences: Mapping[str, Iterable[Frame]]) -> Camera | None:
    """The camera of most images, as far as cameras are known before reading.

    Raises SequenceError as the first frame would.
    """
    cameras: Counter[Camera] = Counter()
    for frames in sequences.values():
        if isinstance(frames, PosedFrames):
            cameras += frames.cameras()
        elif isinstance(frames, Sequence):
            cameras.update(frame.camera for frame in frames if frame.camera is not None)
    return max(cameras, key=lambda camera: cameras[camera], default=None)


def _of_cameras(as_taken: AsTakenBy, total: int) -> list[str]:
    """A notice where not all images are of one camera."""
    if as_taken.camera is None or not as_taken.cameras:
        return as_taken.notices
    others = [f"{count} of {described(camera)}" for camera, count in as_taken.cameras.most_common(_MOST_CAMERAS)]
    if len(as_taken.cameras) > _MOST_CAMERAS:
        others.append("...")
    return [
        f"{as_taken.cameras.total()} of {total} images are of other cameras than {described(as_taken.camera)}, and were"
        f" resampled to it: {', '.join(others)}",
        *as_taken.notices,
    ]


def _sequence_names(
    names: Sequence[str], begun: Sequence[tuple[int, int, int]], cameras: Sequence[str]
) -> tuple[str, ...]:
    """Names of sequences, given by the numbers of their file or folder, in it, and of their camera."""
    several = {
        file for file, numbers in Counter(file for file, _ in {each[:2] for each in begun}).items() if numbers > 1
    }
    return tuple(
        names[file]
        + (f", sequence {number + 1}" if file in several else "")
        + (f", {cameras[camera]}" if camera else "")
        for file, number, camera in begun
    )


class GreyViews:
    """Grey images for landmarks, in a file; `camera` is the given one, or a guess by the size of the first image."""

    def __init__(self, camera: Camera | None, file: IO[bytes]) -> None:
        """Keep images of a camera, None where unknown, in a file."""
        self.camera = None if camera is None else shrunk(camera)
        self._as_taken: AsTakenBy | None = None
        self._file, self._count = file, 0

    def take(self, frame: Frame) -> None:
        """Add an image."""
        if self.camera is None:
            self.camera = shrunk(usual_camera(frame.image.shape[1], frame.image.shape[0]))
        if self._as_taken is None:
            self._as_taken = AsTakenBy(self.camera, (self.camera.width, self.camera.height))
        self._file.write(grey_view(self._as_taken(frame.image, frame.camera), self.camera).data)
        self._count += 1

    @property
    def others(self) -> int:
        """How many of the images were resampled, as of another camera."""
        return 0 if self._as_taken is None else self._as_taken.cameras.total()

    def kept(self) -> UInt8[np.ndarray, "m h w"]:
        """All of them, mapped into memory."""
        assert self.camera is not None  # known from the first image on
        self._file.flush()
        return np.memmap(self._file, np.uint8, mode="r", shape=(self._count, self.camera.height, self.camera.width))


def usual_camera(width: int, height: int) -> Camera:
    """A guess at the camera of images of this size, pixels, without stated intrinsics."""
    focal = _USUAL_FOCAL * max(width, height)
    return Camera(width, height, focal, focal, 0.5 * (width - 1), 0.5 * (height - 1))


def shrunk(camera: Camera) -> Camera:
    """The camera at the size at which landmarks are found."""
    scale = min(1.0, VIEW_PX / max(camera.width, camera.height))
    return camera.scaled(max(1, round(scale * camera.width)), max(1, round(scale * camera.height)))
