"""Videos, folders of images and recordings -> walks: the sharpest images of even stretches, as files."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from jaxtyping import UInt8

from filtering.se3 import Poses
from sequences.datasets.frames import PosedFrames, posed_frames
from sequences.datasets.listing import is_data_set, list_images, require_recording
from sequences.errors import SequenceError
from sequences.frame import Camera, Frame
from sequences.image_sequence import ImageSequence, is_image_sequence
from sequences.mapping.config import MapConfig
from sequences.options import SequenceOptions
from sequences.reader import SequenceReader

_QUALITY = 95  # of JPEGs
_JUDGED_PX = 320  # width at which images are compared by their sharpness
_SPARE = 2  # times as many images as asked for are kept at first
_EXPECTED = "expected a video, a folder of images, a data set or a recording"
_Image = UInt8[np.ndarray, "height width 3"]


@dataclass(frozen=True)
class Picture:
    """One image of a map, as a file.

    Attributes:
        name: Relative to the folder of images; of walks with time stamps it states them.
        time_ns: Its stamp.
        number: How many images its walk has before it.
        size: Width and height, pixels.
        camera: Its intrinsics; None where unknown.
        sharpness: Variance of its Laplacian, to compare it with its neighbours.
        world_from_camera: Recorded pose; None where there is none.
        odometry_from_camera: Pose by odometry, in a frame of each piece.
        piece: Odometry has no gap among images of one piece.
    """

    name: str
    time_ns: int
    number: int
    size: tuple[int, int]
    camera: Camera | None
    sharpness: float
    world_from_camera: Poses | None
    odometry_from_camera: Poses
    piece: int


@dataclass(frozen=True)
class Walk:
    """One continuous recording of a place.

    Attributes:
        name: Of its folder.
        pictures: Its images, in order of time.
        has_stamps: Whether their times were recorded; else they have numbers only.
        begin_ns, end_ns: Stamps of its first and last image, chosen or not.
        motion: What is recorded of its motion.
    """

    name: str
    pictures: tuple[Picture, ...]
    has_stamps: bool
    begin_ns: int
    end_ns: int
    motion: Literal["poses", "odometry", "nothing"]

    def when(self, index: int) -> str:
        """The moment of an image, in words: seconds from the start, or its number."""
        picture = self.pictures[index]
        if not self.has_stamps:
            return f"image {picture.number}"
        return f"{1e-9 * (picture.time_ns - self.begin_ns):.1f} s"


def read_walks(
    inputs: Sequence[Path],
    folder: Path,
    config: MapConfig,
    reading: SequenceOptions | None = None,
    *,
    progress: Callable[[int], None] = lambda read: None,
) -> list[Walk]:
    """Choose images of each input and write them into a folder of its own.

    Args:
        inputs: Videos, folders of images, data sets and recordings.
        folder: Where to write, `folder/walk/name.jpg`.
        config: How many images.
        reading: What to read of recordings.
        progress: Called with the number of images read.

    Raises:
        SequenceError: an input cannot be read, or has no image.
    """
    walks: list[Walk] = []
    count = 0
    for path in inputs:
        source, has_stamps = _opened(path, reading)
        for number, frames in groupby(source, key=lambda frame: frame.sequence):
            name = _free_name(path, number, {walk.name for walk in walks})
            (folder / name).mkdir(parents=True)
            sharpest = _Sharpest(folder, name, config, has_stamps=has_stamps)
            for frame in frames:
                sharpest.take(frame)
                count += 1
                progress(count)
            walks.append(sharpest.walk())
    return _thinned(walks, folder, config.images)


def _opened(path: Path, reading: SequenceOptions | None) -> tuple[ImageSequence | SequenceReader | PosedFrames, bool]:
    """The frames of an input, and whether they have time stamps."""
    if not path.exists():
        raise SequenceError(f"{path}: no such file or folder, {_EXPECTED}")
    if path.is_dir() and is_data_set(path):
        return posed_frames(path, options=reading), list_images(path).assumed_hz is None
    if is_image_sequence(path):
        images = ImageSequence(path, reading)
        return images, images.has_stamps
    require_recording(path)
    reader = SequenceReader(path, reading, odometry="optional")
    if len(reader.camera_names) > 1:  # one of several is enough, and its motion is that of the odometry
        reader = SequenceReader(path, reading, odometry="optional", only_camera=reader.localized_camera)
    return reader, True


def _free_name(path: Path, number: int, taken: set[str]) -> str:
    """A name of a folder that COLMAP's lists of pairs can state: without blanks."""
    stem = path.resolve().stem if path.is_file() else path.resolve().name
    name = re.sub(r"[^\w.-]+", "_", stem, flags=re.ASCII).strip(".") or "walk"
    names = [f"{name}-{number + 1}" if number else name, *(f"{name}-{k}" for k in range(2, len(taken) + number + 3))]
    return next(each for each in names if each not in taken)


@dataclass
class _Motion:
    """The motion of a walk by odometry, followed image by image."""

    odometry_from_camera: Poses = field(default_factory=Poses.identity)
    piece: int = 0
    counts: Counter[str] = field(default_factory=Counter)

    def follow(self, frame: Frame) -> None:
        self.counts["poses"] += frame.world_from_camera is not None
        if frame.odometry is None:
            self.piece, self.odometry_from_camera = self.piece + 1, Poses.identity()
            return
        self.counts["odometry"] += 1
        self.odometry_from_camera = self.odometry_from_camera @ frame.odometry.previous_from_current


class _Sharpest:
    """Keeps the sharpest image of each stretch of a walk; of very many stretches two become one."""

    def __init__(self, folder: Path, name: str, config: MapConfig, *, has_stamps: bool) -> None:
        self._folder, self._name, self._config, self._has_stamps = folder, name, config, has_stamps
        self._length = max(round(1e9 / config.per_second), 1) if has_stamps else 1
        self._kept: list[tuple[int, Picture]] = []
        self._best: tuple[Picture, _Image] | None = None
        self._stretch, self._number, self._begin_ns, self._end_ns = 0, 0, 0, 0
        self._motion = _Motion()

    def take(self, frame: Frame) -> None:
        """The next image."""
        if not self._number:
            self._begin_ns = frame.time_ns
        number, self._number, self._end_ns = self._number, self._number + 1, frame.time_ns
        self._motion.follow(frame)
        stretch = self._stretch_of(frame, number)
        if stretch != self._stretch:
            self._keep()
            self._stretch = self._stretch_of(frame, number)  # they may have become longer
        sharpness = _sharpness(frame.image)
        if self._best is not None and self._best[0].sharpness >= sharpness:
            return
        image, camera = _shrunk(frame.image, frame.camera, self._config.longest_edge)
        picture = Picture(
            f"{self._name}/{_file_name(frame.time_ns if self._has_stamps else None, number)}",
            frame.time_ns,
            number,
            (image.shape[1], image.shape[0]),
            camera,
            sharpness,
            frame.world_from_camera,
            self._motion.odometry_from_camera,
            self._motion.piece,
        )
        self._best = picture, image

    def walk(self) -> Walk:
        """All that was kept; nothing is taken after it."""
        self._keep()
        counts = self._motion.counts
        motion = "poses" if counts["poses"] else "odometry" if counts["odometry"] else "nothing"
        return Walk(
            self._name,
            tuple(picture for _, picture in self._kept),
            self._has_stamps,
            self._begin_ns,
            self._end_ns,
            motion,
        )

    def _stretch_of(self, frame: Frame, number: int) -> int:
        return (frame.time_ns - self._begin_ns if self._has_stamps else number) // self._length

    def _keep(self) -> None:
        if self._best is None:
            return
        picture, image = self._best
        self._best = None
        encoded, data = cv2.imencode(
            ".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, _QUALITY]
        )
        if not encoded:
            raise SequenceError(f"{picture.name}: cannot be encoded as an image")
        (self._folder / picture.name).write_bytes(data.tobytes())
        self._kept.append((self._stretch, picture))
        if len(self._kept) > _SPARE * self._config.images:
            self._length *= 2
            halved = [(stretch // 2, each) for stretch, each in self._kept]
            self._kept = [
                (stretch, _sharpest_of([each for _, each in some], self._folder))
                for stretch, some in groupby(halved, key=lambda kept: kept[0])
            ]


def _thinned(walks: Sequence[Walk], folder: Path, most: int) -> list[Walk]:
    """At most so many images of all walks together, of each the same share, evenly along it."""
    total = sum(len(walk.pictures) for walk in walks)
    if total <= most:
        return list(walks)
    thinned = []
    for walk in walks:
        share = max(most * len(walk.pictures) // total, 1)
        groups = groupby(enumerate(walk.pictures), key=lambda each: each[0] * share // len(walk.pictures))
        kept = [_sharpest_of([picture for _, picture in some], folder) for _, some in groups]
        thinned.append(replace(walk, pictures=tuple(kept)))
    return thinned


def _sharpest_of(pictures: Sequence[Picture], folder: Path) -> Picture:
    """The sharpest; files of the others are removed."""
    best = max(pictures, key=lambda picture: picture.sharpness)
    for picture in pictures:
        if picture is not best:
            (folder / picture.name).unlink()
    return best


def _file_name(time_ns: int | None, number: int) -> str:
    """A name that states a time as `sequences.trajectories.pose_lines.stamp_of` reads it, or else a number."""
    return f"{number:06d}.jpg" if time_ns is None else f"{time_ns // 10**9:09d}.{time_ns % 10**9:09d}.jpg"


def _shrunk(image: _Image, camera: Camera | None, longest_edge: int) -> tuple[_Image, Camera | None]:
    height, width = image.shape[:2]
    scale = longest_edge / max(width, height)
    if scale >= 1.0:
        return image.copy(), camera
    size = max(round(scale * width), 1), max(round(scale * height), 1)
    small = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
    return small, None if camera is None else camera.scaled(*size)


def _sharpness(image: _Image) -> float:
    height, width = image.shape[:2]
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    if width > _JUDGED_PX:
        grey = cv2.resize(grey, (_JUDGED_PX, max(round(_JUDGED_PX * height / width), 1)), interpolation=cv2.INTER_AREA)
    return float(cv2.Laplacian(grey, cv2.CV_32F).var())
