"""All layouts of data sets: which is found, in which order, and how one is added."""

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from sequences.datasets import layouts
from sequences.datasets.frames import posed_frames
from sequences.datasets.listing import files_read, find_layouts, is_recording, list_images
from sequences.errors import SequenceError
from tests.helpers.data_sets import make_tum, write_image


def test_a_folder_or_file_of_no_layout_is_told_what_was_looked_for(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("none")
    with pytest.raises(SequenceError, match="is a file, expected the folder of a data set or the list of a split"):
        list(posed_frames(tmp_path / "notes.txt"))
    with pytest.raises(SequenceError, match="no sequence or data set; looked for") as error:
        list(posed_frames(tmp_path))
    for file in (
        *("metadata.yaml", "groundtruth.txt", "frame-*.pose.txt", "poses_seq*.txt", "poses.txt"),
        *("dataset_train.txt", "images.bin"),
    ):
        assert file in str(error.value)
    with pytest.raises(SequenceError, match="no such folder"):
        list(posed_frames(tmp_path / "nowhere"))


NEW_LAYOUT = """
import numpy as np
from filtering.se3 import Poses
from sequences.datasets.layout import Layout, PosedImages


def list_images(path):
    if not (path / "phone.txt").is_file():
        return None
    return PosedImages("Phone", [path / "0.png"], np.array([7]), Poses.identity(1), [None])


LAYOUT = Layout("Phone", looked_for="phone.txt", order=85, list_images=list_images, list_suffixes=(".phone",))
"""


@pytest.fixture
def new_layout(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[None]:
    """One more file among the layouts."""
    (tmp_path / "more").mkdir()
    (tmp_path / "more" / "phone.py").write_text(NEW_LAYOUT)
    monkeypatch.setattr(layouts, "__path__", [*layouts.__path__, str(tmp_path / "more")])
    find_layouts.cache_clear()
    yield
    find_layouts.cache_clear()


@pytest.mark.usefixtures("new_layout")
def test_a_new_layout_is_one_new_file(tmp_path: Path) -> None:
    scan = tmp_path / "scan"
    scan.mkdir()
    write_image(scan / "0.png", 0)
    with pytest.raises(SequenceError, match=r"odometry\.csv, \.r3d, phone\.txt, transforms\.json, images\.bin$"):
        list_images(scan)
    (scan / "phone.txt").write_text("")
    (frame,) = posed_frames(scan)
    assert (frame.time_ns, frame.image.shape) == (7, (24, 32, 3))
    (scan / "list.phone").write_text("")
    assert not is_recording(scan / "list.phone")
    assert scan in files_read(scan / "list.phone")


def test_a_folder_of_recordings_and_data_sets_names_them(tmp_path: Path) -> None:
    for name in ("desk", "hall"):
        make_tum(tmp_path / name)
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(SequenceError, match=r"no sequence or data set itself; expected what is in it: desk and hall$"):
        list_images(tmp_path)
    (tmp_path / "desk" / "groundtruth.txt").write_text("damaged")
    (tmp_path / "walk.mcap").write_bytes(b"")
    with pytest.raises(SequenceError, match=r"expected what is in it: desk, hall and walk\.mcap$"):
        list_images(tmp_path)
    (tmp_path / "other.bag").write_bytes(b"")
    with pytest.raises(SequenceError, match=r"walk\.mcap \(where they are pieces of one recording, `ros2 bag reindex`"):
        list_images(tmp_path)


def test_layouts_are_not_imported_before_a_data_set_is_read() -> None:
    imported = "[name for name in sys.modules if name.startswith('sequences.datasets.layouts.')]"
    program = f"import sys; from sequences.datasets import frames; assert not {imported}"
    subprocess.run([sys.executable, "-c", program], check=True)
