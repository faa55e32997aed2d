"""7-Scenes by split."""

import re
from pathlib import Path

import numpy as np
import pytest

from sequences.datasets.frames import posed_frames
from sequences.datasets.listing import list_images
from sequences.errors import SequenceError
from sequences.files import UNUSABLE
from tests.helpers.data_sets import make_7scenes


def test_a_7_scenes_split_gives_its_sequences_in_its_order(tmp_path: Path) -> None:
    scene = make_7scenes(tmp_path / "scene", num_images=2, sequences=("seq-01", "seq-02", "seq-03"))
    (scene / "TrainSplit.txt").write_text("sequence3\r\nsequence1\r\n")
    (scene / "TestSplit.txt").write_text("# one of three\nsequence2")
    names = [str(file.relative_to(scene)) for file in list_images(scene / "TrainSplit.txt").files]
    assert names == [f"seq-0{s}/frame-00000{i}.color.png" for s in (3, 1) for i in (0, 1)]
    assert [file.parent.name for file in list_images(scene / "TestSplit.txt").files] == ["seq-02"] * 2
    assert len(list(posed_frames(scene / "TrainSplit.txt", frames=slice(1, None)))) == 3
    assert len(list(posed_frames(scene))) == 6


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("sequence1\nsequence7\n", r":2: sequence7, expected frame-\*\.pose\.txt in .*seq-07"),
        ("sequence1\nsequence01\n", ":2: sequence01 for the second time"),
        ("seq one\n", ":1: 'seq one', expected the name of a sequence, such as sequence1"),
        ("\n", ": names no sequence"),
    ],
)
def test_a_7_scenes_split_that_is_wrong_is_named(content: str, said: str, tmp_path: Path) -> None:
    scene = make_7scenes(tmp_path / "scene", num_images=2)
    (scene / "TestSplit.txt").write_text(content)
    with pytest.raises(SequenceError, match=rf"TestSplit\.txt{said}"):
        list_images(scene / "TestSplit.txt")


def test_7_scenes_poses_and_images_without_each_other_are_counted(tmp_path: Path) -> None:
    folder = make_7scenes(tmp_path / "scene", num_images=5) / "seq-01"
    (folder / "frame-000001.color.png").unlink()
    (folder / "frame-000002.pose.txt").unlink()
    (folder / "frame-000003.pose.txt").write_text("inf 0 0 0\n" * 4)
    images = list_images(folder)
    assert [file.name[:12] for file in images.files] == ["frame-000000", "frame-000004"]
    assert images.skipped == {"no image": 1, "no true pose": 1, "true pose not finite": 1}


@pytest.mark.parametrize(
    ("matrix", "said"),
    [
        (np.diag([1.0, 1, -1, 1]), "no rotation"),
        (np.diag([1.02, 1.02, 1.02, 1]), "no rotation"),
        (np.eye(4) + np.outer([0, 0, 0, 1.0], [2, 3, 4, 0]), r"last row \[2\.0, 3\.0, 4\.0, 1\.0\], expected 0 0 0 1"),
    ],
)
def test_a_7_scenes_pose_left_handed_stretched_or_transposed_is_left_out_and_more_than_half_of_them_refused(
    matrix: np.ndarray, said: str, tmp_path: Path
) -> None:
    scene = make_7scenes(tmp_path / "scene", num_images=3)
    np.savetxt(scene / "seq-01" / "frame-000001.pose.txt", matrix)
    images = list_images(scene)
    assert (len(images), images.skipped) == (2, {UNUSABLE: 1})
    assert re.match(rf"1 of 3 poses left out, the first: .*frame-000001\.pose\.txt: .*{said}", images.notices[0])
    np.savetxt(scene / "seq-01" / "frame-000000.pose.txt", matrix)
    with pytest.raises(SequenceError, match=rf"frame-000000\.pose\.txt: .*{said}.*; 2 of 3 poses cannot be used"):
        list_images(scene)
