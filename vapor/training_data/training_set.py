"""Posed frames -> one array of small images, on disk in a nameless temporary file, and their poses."""

from __future__ import annotations

import mmap
import re
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import combinations, product
from math import inf
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Int64, UInt8

from filtering.errors import VaporTrackError
from filtering.motion import Odometry
from filtering.se3 import Poses
from sequences.datasets import listing
from sequences.datasets.frames import PosedFrames, posed_frames
from sequences.datasets.layout_helpers.packed import ImageFile
from sequences.datasets.listing import is_recording, list_images
from sequences.frame import Camera, Frame
from sequences.options import OdometryUse, SequenceOptions
from sequences.recordings.bag import bag_files
from vapor.cameras import AsTakenBy, described
from vapor.images import centre_crop, scale_to_cover

_MOST_CAMERAS = 3  # that are named
_FAR_M = 1e4  # beyond, float32 has steps of a millimetre
_COARSEST_M = 0.1  # that such a step may have
_STILL_M, _STILL_RAD = 0.005, float(np.deg2rad(0.5))  # of a camera that stands, at most
_COMPARED, _COARSE = 50, (8, 6)  # images, and the size at which they are compared, pixels
_FEW = 100  # images


class TrainingError(VaporTrackError):
    """A network cannot be trained on this data, or with this configuration."""


@dataclass(frozen=True)
class TrainingSet:
    """Scaled images with their poses.

    Attributes:
        images: RGB of one size, scaled: all that were read, of which these are some; memory-mapped, so the system
            decides what stays in memory.
        rows: Which of `images` each of these is, (n,).
        poses: world_from_camera, batch (n,).
        sequence: Index of the sequence each image is from; images of one sequence lie together, in its order.
        names: Of the sequences, by that index: of the file or folder that each is from.
        camera_size: Width and height of the camera's images, pixels: of the first image where no camera is known.
        times_ns: Stamps of the images, integer nanoseconds, (n,).
        odometry: Motion since the image before, n of them; None where that image is not here, or none was recorded.
        skipped: Images and poses of the data that were left out in reading, by reason.
        notices: What a person should know of the data.
        camera: What took the images, or what they were resampled to; None where unknown.
    """

    images: UInt8[np.ndarray, "m h w 3"]
    rows: Int64[np.ndarray, " n"]
    poses: Poses
    sequence: Int64[np.ndarray, " n"]
    names: tuple[str, ...]
    camera_size: tuple[int, int]
    times_ns: Int64[np.ndarray, " n"]
    odometry: tuple[Odometry | None, ...]
    skipped: Counter[str] = field(default_factory=Counter)
    notices: tuple[str, ...] = ()
    camera: Camera | None = None

    def __len__(self) -> int:
        return len(self.sequence)

    def unload(self) -> None:
        """Give back the memory that images read from disk take; they are read again when they are used."""
        if isinstance(self.images.base, mmap.mmap) and hasattr(mmap, "MADV_DONTNEED"):
            self.images.base.madvise(mmap.MADV_DONTNEED)

    def select(self, indices: Int64[np.ndarray, " k"]) -> TrainingSet:
        """Some of the images, (k,), in increasing order; none of them is copied."""
        follows = np.diff(indices, prepend=-2) == 1
        return replace(
            self,
            rows=self.rows[indices],
            poses=self.poses[indices],
            sequence=self.sequence[indices],
            times_ns=self.times_ns[indices],
            odometry=tuple(self.odometry[i] if after else None for i, after in zip(indices, follows, strict=True)),
        )


def open_sequences(
    data: Sequence[Path | str], reading: SequenceOptions | None = None, odometry: OdometryUse = "optional"
) -> dict[str, Iterable[Frame]]:
    """Frames of each `PATH` or `PATH@START:STOP`, by a name without its folder.

    Args:
        data: The entries.
        reading: What to read of those that are MCAP sequences; None for all of it, as found.
        odometry: Whether their odometry is read.

    Raises:
        TrainingError: what follows the @ is no range.
    """
    return {
        name: posed_frames(path, frames=frames, options=reading, odometry=odometry)
        for name, (path, frames) in name_entries(data).items()
    }


def name_entries(data: Sequence[Path | str]) -> dict[str, tuple[Path, slice]]:
    """Path and frames of each `PATH` or `PATH@START:STOP`, by a name without its folder.

    Raises:
        TrainingError: what follows the @ is no range.
    """
    named: dict[str, tuple[Path, slice]] = {}
    for number, entry in enumerate(data):
        path, frames = parse_entry(entry)
        parts = Path(str(entry)).parts[-2 if path.suffix == ".txt" else -1 :]  # lists of splits are all named alike
        name = "/".join(parts)
        named[name if name not in named else f"{name} ({number + 1})"] = path, frames
    return named


def parse_entry(entry: Path | str) -> tuple[Path, slice]:
    """Path and frames of `PATH` or `PATH@START:STOP`.

    Raises:
        TrainingError: what follows the @ is no range.
    """
    match = re.fullmatch(r"(?P<path>.+)@(?P<start>\d*):(?P<stop>\d*)", str(entry))
    if match:
        return Path(match["path"]), slice(int(match["start"] or 0), int(match["stop"]) if match["stop"] else None)
    if re.search(r"@[^/]*:[^/]*$", str(entry)) and not Path(entry).exists():
        raise TrainingError(f"{entry}: expected START:STOP after @ to be whole numbers, or one of them left out")
    return Path(entry), slice(None)


def files_read(data: Sequence[Path | str], reading: SequenceOptions | None = None) -> Iterator[Path]:
    """Files and folders that `PATH`s and `PATH@START:STOP`s are read from, for outputs: they must be none of these.

    Raises:
        TrainingError: what follows an @ is no range.
    """
    for entry in data:
        yield from listing.files_read(parse_entry(entry)[0])
    yield from () if reading is None else reading.files_read


def require_apart(data: Sequence[Path | str], held_out: Sequence[Path | str] | None = None) -> None:
    """Refuse to judge by images that are trained on: the same files, or the same frames of one recording.

    Args:
        data: Each `PATH` or `PATH@START:STOP`.
        held_out: Likewise; None where the last part of each of `data` is held out, so that no two may share images.

    Raises:
        TrainingError: two share images, or what follows an @ is no range.
        SequenceError: unreadable data.
    """
    source, files = cache(_source), cache(_files)
    for entry, other in combinations(data, 2) if held_out is None else product(data, held_out):
        (path, frames), (its_path, its_frames) = source(entry), source(other)
        if path == its_path:
            stop = min(inf if part.stop is None else part.stop for part in (frames, its_frames))
            shared = max(frames.start or 0, its_frames.start or 0) < stop
        else:
            shared = not files(entry).isdisjoint(files(other))
        if shared:
            raise TrainingError(
                f"{other}: shares images with {entry}, which is trained on; expected none of them to be held out"
            )


def _source(entry: Path | str) -> tuple[Path, slice]:
    """Where `PATH` or `PATH@START:STOP` lies, whatever links lead there, and which frames of it."""
    path, frames = parse_entry(entry)
    return path.resolve(), frames


def _files(entry: Path | str) -> set[ImageFile]:
    """Images of `PATH` or `PATH@START:STOP`; of a recording all that it is made of, whichever frames."""
    path, frames = parse_entry(entry)
    files = bag_files(path) if is_recording(path) else list_images(path)[frames].files
    return {file.resolve() for file in files}


def load_training_set(
    sequences: Mapping[str, Iterable[Frame]],
    frame_size: tuple[int, int] | Callable[[int, int], tuple[int, int]],
    *,
    central: bool = True,
    camera: Camera | None = None,
    progress: Callable[[int], None] = lambda _: None,
) -> TrainingSet:
    """Read frames once, scale each image to cover a frame, and keep it in a temporary file.

    Args:
        sequences: Frames by the name of their file or folder; frames without a pose are left out.
        frame_size: Width and height of that frame, pixels, or what gives them for those of the camera.
        central: Keep that much of the middle only, so that images may differ in size; else the whole image, and all
            must have the aspect of the first.
        camera: Whose images they shall be, where intrinsics are known; None for the camera of most of them.
        progress: Called with the number of images read so far.

    Raises:
        TrainingError: a sequence without posed frames, a pose that is not finite, or images of different aspect.
    """
    matrices: list[np.ndarray] = []
    sources: list[tuple[int, int]] = []
    skipped: Counter[str] = Counter()
    notices: list[str] = []
    times_ns: list[int] = []
    odometry: list[Odometry | None] = []
    shape: tuple[int, ...] | None = None
    camera = camera or _commonest_camera(sequences)
    camera_size = (camera.width, camera.height) if camera else None
    as_taken: AsTakenBy | None = None
    with tempfile.TemporaryFile() as file:
        for index, (name, frames) in enumerate(sequences.items()):
            follows = False
            num_before = len(sources)
            for frame in frames:
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
                    number = len(sources) - num_before + 1
                    raise TrainingError(
                        f"{name}: image {number}, at {frame.time_ns} ns, is {image.shape[1]} x {image.shape[0]} after"
                        f" scaling, expected {shape[1]} x {shape[0]} as the first (or augment.crop central)"
                    )
                if not frame.world_from_camera.is_finite():
                    raise TrainingError(f"{name}: true pose at {frame.time_ns} ns is not finite")
                file.write(np.ascontiguousarray(image).data)
                matrices.append(frame.world_from_camera.as_matrix())
                sources.append((index, frame.sequence))
                times_ns.append(frame.time_ns)
                odometry.append(frame.odometry if follows else None)
                follows = True
                progress(len(sources))
            if len(sources) == num_before:
                raise TrainingError(f"{name}: no image with a true pose, expected at least one")
            if isinstance(frames, PosedFrames):
                skipped += frames.skipped
                notices += frames.notices
        if shape is None or camera_size is None or as_taken is None:
            raise TrainingError("no training data, expected at least one sequence")
        file.flush()
        images = np.memmap(file, np.uint8, mode="r", shape=(len(sources), *shape))
    poses = Poses.from_matrix(np.stack(matrices))
    notices += [*_of_cameras(as_taken, len(sources)), *too_far(poses)]
    begins = np.any(np.diff(np.array(sources), axis=0, prepend=[sources[0]]) != 0, axis=1)
    return TrainingSet(
        images,
        np.arange(len(sources)),
        poses,
        np.cumsum(begins),
        _sequence_names(list(sequences), [sources[i] for i in [0, *np.flatnonzero(begins)]]),
        camera_size,
        np.array(times_ns, np.int64),
        tuple(odometry),
        skipped,
        tuple(notices),
        as_taken.camera,
    )


def _commonest_camera(sequences: Mapping[str, Iterable[Frame]]) -> Camera | None:
    """The camera of most images, as far as that is known before they are read."""
    cameras: Counter[Camera] = Counter()
    for frames in sequences.values():
        if isinstance(frames, PosedFrames):
            cameras += frames.cameras()
        elif isinstance(frames, Sequence):
            cameras.update(frame.camera for frame in frames if frame.camera is not None)
    return max(cameras, key=lambda camera: cameras[camera], default=None)


def _of_cameras(as_taken: AsTakenBy, total: int) -> list[str]:
    """What to say where not all images are of one camera."""
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


def _sequence_names(names: Sequence[str], begun: Sequence[tuple[int, int]]) -> tuple[str, ...]:
    """Of sequences by the number of their file or folder and their own; the latter is told where there are several."""
    several = {file for file, count in Counter(file for file, _ in begun).items() if count > 1}
    return tuple(f"{names[file]}, sequence {number + 1}" if file in several else names[file] for file, number in begun)


def require_variety(images: TrainingSet) -> None:
    """Refuse images from which nothing can be learned: of a camera that stands, or sees nothing, or is out of range.

    Raises:
        TrainingError: what all of them have in common.
    """
    poses, few = images.poses, np.linspace(0, len(images) - 1, min(len(images), _COMPARED)).astype(int)
    moved_m, turned = poses.distance(poses[[0]])
    if len(images) > 1 and moved_m.max() < _STILL_M and turned.max() < _STILL_RAD:
        raise TrainingError(
            f"the camera does not move: all {len(images)} true poses are within {1e3 * _STILL_M:g} mm and"
            f" {np.degrees(_STILL_RAD):g}° of the first, expected a walk"
        )
    looks = np.stack(
        [
            cv2.resize(np.asarray(image), _COARSE, interpolation=cv2.INTER_AREA)
            for image in images.images[images.rows[few]]
        ]
    )
    if len(images) > 1 and looks.astype(float).std(axis=0).max() < 1.0:
        raise TrainingError(
            f"all {len(images)} images are alike, to within a level of grey, expected those of a camera that sees where"
            " it is"
        )
    step_m = float(np.spacing(np.float32(np.abs(poses.translation).max())))
    if step_m > _COARSEST_M:
        raise TrainingError(
            f"positions up to {np.abs(poses.translation).max():.3g} m from zero, of which float32 keeps {step_m:.2g} m"
            " only, expected coordinates near zero: --ground-truth-origin takes a point off"
        )


def too_few(images: TrainingSet) -> list[str]:
    """What to say of a number of images with which hardly any place can be learned."""
    if len(images) >= _FEW:
        return []
    return [f"{len(images)} images to learn from: a place takes hundreds, along all ways that will be gone"]


def too_far(poses: Poses) -> list[str]:
    """What to say of positions so far from zero that the network's arithmetic rounds them."""
    furthest_m = float(np.abs(poses.translation).max())
    if furthest_m < _FAR_M:
        return []
    step_m = float(np.spacing(np.float32(furthest_m)))
    return [
        f"positions up to {furthest_m:.3g} m from zero: the network tells them to {step_m:.2g} m only;"
        " --ground-truth-origin takes a point near them off"
    ]
