"""Data sets whose images are coloured dots, drawn by the projection that the format itself describes."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from sequences.datasets.convert import convert
from sequences.datasets.frames import posed_frames
from sequences.datasets.layout import PosedImages
from sequences.datasets.listing import list_images
from sequences.errors import SequenceError
from sequences.frame import Frame
from tests.helpers import dot_scene
from tests.helpers.dot_scene import misses
from tests.helpers.phone_data_sets import (
    NUM,
)


def check(path: Path, indices: list[int], times_ns: list[int] | None, *, within_px: float = 0.7) -> list[Frame]:
    """Every dot is where the pose and the camera that were read put it, in all images, and these are of their times."""
    frames = list(posed_frames(path))
    assert len(indices) == len(frames)
    for index, frame in zip(indices, frames, strict=True):
        metres, radians = frame.world_from_camera.distance(dot_scene.true_pose(index))
        assert metres < 1e-5
        assert radians < 1e-5
        assert misses(frame).max() < within_px
    if times_ns is not None:
        assert [frame.time_ns for frame in frames] == times_ns
    return frames


def check_conversion(path: Path, folder: Path, indices: list[int], *, within_px: float = 0.7) -> None:
    """What `convert` writes is read back as the same images, poses and times."""
    assert convert(path, folder / "out.mcap").num_images == len(indices)
    check(folder / "out.mcap", indices, [frame.time_ns for frame in posed_frames(path)], within_px=within_px)


def refuse(path: Path, *said: str) -> None:
    """Reading fails with one line that says all this."""
    with pytest.raises(SequenceError) as error:
        list_images(path)
    line = str(error.value)
    assert "\n" not in line
    for words in said:
        assert words in line, line


def leaves_out(path: Path, num_rows: int, *said: str) -> PosedImages:
    """Reading goes on without one row, which is counted; of it one notice says all this."""
    listed = list_images(path)
    (notice,) = listed.notices
    assert notice.startswith(f"1 of {num_rows} ")
    for words in said:
        assert words in notice, notice
    return listed


def edit(file: Path, change: Callable[[str], str]) -> None:
    before = file.read_text()
    after = change(before)
    assert after != before
    file.write_text(after)


def edit_json(file: Path, change: Callable[[dict], object]) -> None:
    content = json.loads(file.read_text())
    change(content)
    file.write_text(json.dumps(content))


THIRTIETHS = [i * 1_000_000_000 // 30 for i in range(NUM)]
