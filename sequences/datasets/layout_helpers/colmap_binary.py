"""COLMAP's binary model, little endian: `cameras.bin`, `images.bin`, `points3D.bin` as rows of the text model."""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float64, Int64

from filtering.errors import quoted
from sequences.errors import SequenceError

NUM_PARAMETERS = {
    "SIMPLE_PINHOLE": 3,
    "PINHOLE": 4,
    "SIMPLE_RADIAL": 4,
    "RADIAL": 5,
    "OPENCV": 8,
    "OPENCV_FISHEYE": 8,
    "FULL_OPENCV": 12,
    "FOV": 5,
    "SIMPLE_RADIAL_FISHEYE": 4,
    "RADIAL_FISHEYE": 5,
    "THIN_PRISM_FISHEYE": 12,
    "RAD_TAN_THIN_PRISM_FISHEYE": 16,
    "SIMPLE_DIVISION": 4,
    "DIVISION": 5,
    "SIMPLE_FISHEYE": 3,
    "FISHEYE": 4,
    "EUCM": 6,
    "EQUIRECTANGULAR": 2,
    "SKEWED_PINHOLE": 5,
    "BROWN_CONRADY": 8,
}
"""COLMAP's camera models in the order of their numbers, and how many parameters each has."""
UNDISTORTER = (
    "PINHOLE cameras are made by `colmap image_undistorter --image_path IMAGES --input_path MODEL --output_path NEW"
    " --output_type COLMAP`"
)
"""The way out for images of other models than can be undistorted here."""
_MODELS = tuple(NUM_PARAMETERS.items())
_KEYPOINT, _TRACK_BYTES = np.dtype([("pixel", "<f8", 2), ("point", "<i8")]), 8
LARGEST_ID = 2**63 - 2
"""Of a point; the next is that of none."""
_LONGEST_NAME, _MOST_KEYPOINTS = 4096, 1_000_000


def camera_rows(file: Path) -> Iterator[tuple[int, list[str]]]:
    """Number and fields `CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]` of each camera.

    Raises SequenceError where the file cannot be read, is cut off, or has a camera of an unknown model.
    """
    with _Records(file) as records:
        for number in range(1, records.take("Q")[0] + 1):
            camera_id, model, width, height = records.take("iiQQ")
            if not 0 <= model < len(_MODELS):  # what follows cannot be found without the number of its parameters
                raise SequenceError(
                    f"{file}:{number}: camera model {model} is unknown, expected 0 to {len(_MODELS) - 1}"
                    f" ({_MODELS[-1][0]}); {UNDISTORTER}, of the version that wrote it"
                )
            name, num_parameters = _MODELS[model]
            parameters = records.take(f"{num_parameters}d")
            yield number, [str(camera_id), name, str(width), str(height), *map(repr, parameters)]


def image_rows(file: Path) -> Iterator[tuple[int, list[str]]]:
    """Number and fields `IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME` of each image; keypoints are passed over.

    Raises SequenceError where the file cannot be read or is cut off, or a name is no UTF-8.
    """
    with _Records(file) as records:
        for number in range(1, records.take("Q")[0] + 1):
            image_id, *pose, camera_id = records.take("i7di")
            name = records.text()
            records.skip(_KEYPOINT.itemsize * records.take("Q")[0])
            yield number, [str(image_id), *map(repr, pose), str(camera_id), name]


def keypoint_rows(file: Path) -> Iterator[tuple[str, Float64[np.ndarray, "k 2"], Int64[np.ndarray, " k"]]]:
    """Name of each image, and X and Y of the keypoints that are of a point, with its POINT3D_ID.

    Raises SequenceError where the file cannot be read or is cut off, a name is no UTF-8, or an image has too many
    keypoints.
    """
    with _Records(file) as records:
        for _ in range(records.take("Q")[0]):
            records.take("i7di")
            name = records.text()
            if (count := records.take("Q")[0]) > _MOST_KEYPOINTS:
                raise SequenceError(f"{file}: {quoted(name)} has {count} keypoints, expected {_MOST_KEYPOINTS} at most")
            keypoints = records.array(_KEYPOINT, count)
            keypoints = keypoints[keypoints["point"] >= 0]
            yield name, keypoints["pixel"].astype(np.float64), keypoints["point"].astype(np.int64)


def point_rows(file: Path) -> Iterator[tuple[int, *tuple[float, ...]]]:
    """`POINT3D_ID X Y Z R G B` of each point; the images that show it are passed over.

    Raises SequenceError where the file cannot be read or is cut off.
    """
    with _Records(file) as records:
        for _ in range(records.take("Q")[0]):
            point_id, *point, _, num_images = records.take("q3d3BdQ")
            records.skip(_TRACK_BYTES * num_images)
            yield point_id, *point


class _Records:
    def __init__(self, file: Path) -> None:
        self._file = file

    def __enter__(self) -> _Records:
        try:
            self._stream = open(self._file, "rb")
        except OSError as error:
            raise SequenceError(f"{self._file}: cannot read: {error.strerror or error}") from error
        self._size = os.fstat(self._stream.fileno()).st_size
        return self

    def __exit__(self, *_: object) -> None:
        self._stream.close()

    def take(self, numbers: str) -> tuple:
        """The next numbers, in the notation of `struct`."""
        return struct.unpack(f"<{numbers}", self._bytes(struct.calcsize(f"<{numbers}")))

    def text(self) -> str:
        """Text up to a zero byte."""
        found = bytearray()
        while (byte := self._bytes(1)) != b"\0":
            found += byte
            if len(found) > _LONGEST_NAME:
                raise SequenceError(f"{self._file}: name {quoted(bytes(found))} is too long, expected that of a file")
        try:
            return found.decode("utf-8")
        except UnicodeDecodeError as error:
            raise SequenceError(f"{self._file}: name {quoted(bytes(found))} is no UTF-8 text") from error

    def array(self, kind: np.dtype, count: int) -> np.ndarray:
        """The next records of one kind; it is known first that the file has so many."""
        if (size := kind.itemsize * count) > self._size - self._stream.tell():
            self._cut_off()
        return np.frombuffer(self._bytes(size), kind)

    def skip(self, count: int) -> None:
        """Pass over some bytes."""
        if count > self._size - self._stream.tell():
            self._cut_off()
        self._stream.seek(count, os.SEEK_CUR)

    def _bytes(self, count: int) -> bytes:
        data = self._stream.read(count)
        if len(data) < count:
            self._cut_off()
        return data

    def _cut_off(self) -> None:
        raise SequenceError(f"{self._file}: ends at byte {self._size} within a record, expected a complete file")
