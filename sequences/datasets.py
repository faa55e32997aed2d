"""Images with true poses, as data sets lie on disk: the one entry for training."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path

import numpy as np
from jaxtyping import Int64

from filtering.se3 import Poses
from sequences.errors import SequenceError
from sequences.frame import Camera, Frame
from sequences.messages import decode_image_bytes
from sequences.pairing import interpolate
from sequences.reader import MAX_TRUE_POSE_GAP_S, SequenceOptions, SequenceReader
from sequences.tum import parse_time_ns, read_lines, read_tum

SEVEN_SCENES_HZ = 30  # the data set has no time stamps; this is the rate of its sensor
_LAYOUTS = (
    "an .mcap file, a rosbag2 folder (metadata.yaml), a TUM RGB-D folder (rgb.txt and groundtruth.txt),"
    " a 7-Scenes sequence folder (frame-*.color.png or .jpg with frame-*.pose.txt) or a folder of such seq-*"
)
# Published intrinsics at 640 x 480, by a part of the folder's name.
_KNOWN_CAMERAS = {
    "freiburg1": Camera(640, 480, 517.3, 516.5, 318.6, 255.3),
    "freiburg2": Camera(640, 480, 520.9, 521.0, 325.1, 249.7),
    "freiburg3": Camera(640, 480, 535.4, 539.2, 320.1, 247.6),
}
_TUM_CAMERA = Camera(640, 480, 525.0, 525.0, 319.5, 239.5)
_SEVEN_SCENES_CAMERA = Camera(640, 480, 585.0, 585.0, 320.0, 240.0)


@dataclass(frozen=True)
class PosedImages:
    """Images on disk with their true poses, in order of time.

    Attributes:
        layout: "TUM RGB-D" or "7-Scenes".
        files: Image files.
        times_ns: Their stamps, strictly increasing.
        world_from_camera: True poses, batch (n,).
        camera: Intrinsics, in pixels of the images.
        skipped: Images left out, by reason.
    """

    layout: str
    files: list[Path]
    times_ns: Int64[np.ndarray, " n"]
    world_from_camera: Poses
    camera: Camera
    skipped: Counter[str] = field(default_factory=Counter)

    def __len__(self) -> int:
        return len(self.files)

    def __getitem__(self, index: slice) -> PosedImages:
        return replace(
            self,
            files=self.files[index],
            times_ns=self.times_ns[index],
            world_from_camera=self.world_from_camera[index],
        )


def posed_frames(path: Path, *, frames: slice = slice(None), options: SequenceOptions | None = None) -> Iterator[Frame]:
    """Frames with true poses, in order of time; MCAP sequences with their odometry, where there is any to be found.

    Args:
        path: MCAP file, rosbag2 folder, TUM RGB-D folder, 7-Scenes sequence, or 7-Scenes scene (all its sequences).
        frames: Which of them; for MCAP, of those with a true pose, and not counted from the end.
        options: Topics and stretch of an MCAP sequence; folders of images ignore it.

    Raises:
        SequenceError: the layout is unknown, a file is missing or damaged, or no frame is left.
    """
    path = Path(path)
    number = 0
    if _is_bag(path):
        if any(bound is not None and bound < 0 for bound in (frames.start, frames.stop, frames.step)):
            raise SequenceError(
                f"{path}: frames {frames.start}:{frames.stop}:{frames.step} count from the end, which"
                " a stream does not know; expected numbers from 0 on"
            )
        posed = _posed(SequenceReader(path, options, odometry="optional"))
        for number, frame in enumerate(islice(posed, frames.start, frames.stop, frames.step), start=1):
            follows = number > 1 and frames.step in (None, 1)
            yield frame if follows else replace(frame, odometry=None)
    else:
        for number, frame in enumerate(_load(list_images(path)[frames]), start=1):  # noqa: B007
            yield frame
    if number == 0:
        raise SequenceError(
            f"{path}: no image with a true pose in frames {frames.start}:{frames.stop}:{frames.step},"
            " expected at least one"
        )


def count_frames(path: Path) -> int:
    """How many frames `posed_frames` yields at most: for progress."""
    path = Path(path)
    return SequenceReader(path, odometry="unread").num_images if _is_bag(path) else len(list_images(path))


def list_images(path: Path) -> PosedImages:
    """Images and true poses of a TUM RGB-D or 7-Scenes folder.

    Raises:
        SequenceError: the layout is unknown, a file is missing or damaged, or no image has a true pose.
    """
    path = Path(path)
    if (path / "rgb.txt").is_file() and (path / "groundtruth.txt").is_file():
        images = _list_tum(path)
    elif sequences := _seven_scenes_sequences(path):
        images = _list_seven_scenes(path, sequences)
    else:
        what = "holds none of these layouts" if path.is_dir() else "no such folder"
        if path.is_file():
            what = "is a file, expected the folder of a TUM RGB-D or 7-Scenes data set"
        raise SequenceError(f"{path}: {what}; looked for {_LAYOUTS}")
    if not len(images):
        raise SequenceError(f"{path}: no image with a true pose: {dict(images.skipped)}; expected at least one")
    return images


def _is_bag(path: Path) -> bool:
    return path.is_file() or (path / "metadata.yaml").is_file()


def _posed(frames: Iterable[Frame]) -> Iterator[Frame]:
    """Those with a true pose; without odometry where the frame before was left out."""
    follows = True
    for frame in frames:
        if frame.world_from_camera is not None:
            yield frame if follows else replace(frame, odometry=None)
        follows = frame.world_from_camera is not None


def _load(images: PosedImages) -> Iterator[Frame]:
    """Decode images; those that cannot be are left out, unless it is all of them."""
    problem = None
    num_loaded = 0
    for i, file in enumerate(images.files):
        try:
            image = decode_image_bytes(read_image_bytes(file))
        except SequenceError as error:
            problem = problem or f"{file}: {error}"
            continue
        num_loaded += 1
        yield Frame(int(images.times_ns[i]), image, None, images.world_from_camera[i], images.camera)
    if problem and not num_loaded:
        raise SequenceError(f"no image left: {problem}")


def read_image_bytes(file: Path) -> bytes:
    """Bytes of an image file. Raises SequenceError where it cannot be read."""
    try:
        return file.read_bytes()
    except OSError as error:
        raise SequenceError(f"{file}: cannot read the image: {error.strerror or error}") from error


# --- TUM RGB-D -------------------------------------------------------------------------------------


def _list_tum(path: Path) -> PosedImages:
    """`rgb.txt` with `groundtruth.txt`, the true pose interpolated to each image's time."""
    skipped: Counter[str] = Counter()
    truth = read_tum(path / "groundtruth.txt")
    times_ns: list[int] = []
    files: list[Path] = []
    for number, line in enumerate(read_lines(path / "rgb.txt"), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        where, fields = f"{path / 'rgb.txt'}:{number}", line.split(maxsplit=1)
        if len(fields) != 2:
            raise SequenceError(f"{where}: {line!r}, expected `time file`")
        time_ns = parse_time_ns(fields[0], where)
        if times_ns and time_ns <= times_ns[-1]:
            skipped["time stamp not increasing"] += 1
            continue
        times_ns.append(time_ns)
        files.append(path / fields[1].strip())
    times = np.array(times_ns, np.int64)
    poses, covered = interpolate(truth.times_ns, truth.poses, times, max_gap_s=MAX_TRUE_POSE_GAP_S)
    if not covered.all():
        skipped["true pose does not cover"] += int((~covered).sum())
    kept = np.flatnonzero(covered)
    known = next((camera for name, camera in _KNOWN_CAMERAS.items() if name in path.name), _TUM_CAMERA)
    files = [files[i] for i in kept]
    return PosedImages("TUM RGB-D", files, times[kept], poses[kept], _camera(path, files, known), skipped)


# --- 7-Scenes --------------------------------------------------------------------------------------


def _seven_scenes_sequences(path: Path) -> list[Path]:
    """The folder itself where it holds frames, else its seq-* that do."""
    if not path.is_dir():
        return []
    folders = [path, *sorted(path.glob("seq-*"))]
    found = [folder for folder in folders if next(folder.glob("frame-*.pose.txt"), None) is not None]
    return found[:1] if found and found[0] == path else found


def _list_seven_scenes(path: Path, sequences: list[Path]) -> PosedImages:
    """`frame-*.color.*` with `frame-*.pose.txt`; sequences follow each other with a second between."""
    skipped: Counter[str] = Counter()
    files: list[Path] = []
    times_ns: list[int] = []
    matrices: list[np.ndarray] = []
    begin_ns = 0
    for folder in sequences:
        last_ns = begin_ns
        images = {_frame_number(p): p for ext in ("png", "jpg") for p in folder.glob(f"frame-*.color.{ext}")}
        for number in sorted(images):
            file = images[number]
            pose_file = file.with_name(file.name.split(".")[0] + ".pose.txt")
            if not pose_file.is_file():
                skipped["no true pose"] += 1
                continue
            matrix = _read_matrix(pose_file)
            if matrix is None:
                skipped["true pose not finite"] += 1
                continue
            last_ns = begin_ns + number * 1_000_000_000 // SEVEN_SCENES_HZ
            files.append(file)
            times_ns.append(last_ns)
            matrices.append(matrix)
        begin_ns = last_ns + 1_000_000_000
    poses = Poses.from_matrix(np.array(matrices).reshape(-1, 4, 4))
    camera = _camera(sequences[0], files, _SEVEN_SCENES_CAMERA)
    return PosedImages("7-Scenes", files, np.array(times_ns, np.int64), poses, camera, skipped)


def _frame_number(path: Path) -> int:
    match = re.match(r"frame-(\d+)\.", path.name)
    if match is None:
        raise SequenceError(f"{path}: expected a name such as frame-000000.color.png")
    return int(match[1])


def _read_matrix(file: Path) -> np.ndarray | None:
    """A 4 x 4 camera-to-world matrix, its rotation made exact; None where it is not finite."""
    try:
        matrix = np.array([[float(value) for value in line.split()] for line in read_lines(file) if line.strip()])
    except ValueError as error:
        raise SequenceError(f"{file}: {error}; expected a 4 x 4 matrix of numbers") from error
    if matrix.shape != (4, 4):
        raise SequenceError(f"{file}: shape {matrix.shape}, expected a 4 x 4 matrix")
    if not np.isfinite(matrix).all():
        return None
    u, _, vt = np.linalg.svd(matrix[:3, :3])
    if np.abs(u @ vt - matrix[:3, :3]).max() > 1e-2 or np.linalg.det(u @ vt) < 0:
        raise SequenceError(f"{file}: the upper left 3 x 3 is no rotation, expected a camera-to-world matrix")
    matrix[:3, :3] = u @ vt
    return matrix


# --- intrinsics ------------------------------------------------------------------------------------


def _camera(folder: Path, files: list[Path], known: Camera) -> Camera:
    """Intrinsics from `intrinsics.json` in the folder or the one above, else the known ones; scaled to the images."""
    camera = known
    for file in (folder / "intrinsics.json", folder.parent / "intrinsics.json"):
        if file.is_file():
            camera = _read_intrinsics(file)
            break
    for image_file in files:
        try:
            height, width = decode_image_bytes(read_image_bytes(image_file)).shape[:2]
        except SequenceError:
            continue  # counted when it is its turn
        return _scaled(camera, width, height)
    return camera


def _read_intrinsics(file: Path) -> Camera:
    keys = ("width", "height", "fx", "fy", "cx", "cy")
    try:
        values = json.loads("\n".join(read_lines(file)))
        width, height, fx, fy, cx, cy = (float(values[key]) for key in keys)
    except (ValueError, KeyError, TypeError) as error:
        raise SequenceError(
            f"{file}: {type(error).__name__}: {error}; expected JSON with {', '.join(keys)} in pixels"
        ) from error
    return Camera(int(width), int(height), fx, fy, cx, cy)


def _scaled(camera: Camera, width: int, height: int) -> Camera:
    """The same camera at another image size; the image's edge, half a pixel from the first centre, stays the edge."""
    if (width, height) == (camera.width, camera.height):
        return camera
    sx, sy = width / camera.width, height / camera.height
    return Camera(
        width, height, camera.fx * sx, camera.fy * sy, (camera.cx + 0.5) * sx - 0.5, (camera.cy + 0.5) * sy - 0.5
    )
