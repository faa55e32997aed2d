"""Cambridge Landmarks: lists of images with poses, and what is wrong with them."""

import json
from pathlib import Path

import numpy as np
import pytest

from filtering.se3 import Poses
from sequences.datasets.listing import list_images
from sequences.errors import SequenceError
from tests.helpers.data_sets import (
    HEADER,
    INTRINSICS,
    THIRTIETH_NS,
    cambridge_row,
    check,
    make_cambridge,
    true_pose,
    write_images,
)


def test_a_cambridge_list_gives_its_images_by_sequence_and_frame(tmp_path: Path) -> None:
    scene = make_cambridge(tmp_path / "scene")
    expected_ns = [0, THIRTIETH_NS, THIRTIETH_NS + 1e9, 2 * THIRTIETH_NS + 1e9]
    check(scene / "dataset_train.txt", [0, 1, 2, 3], expected_ns)
    check(scene / "dataset_test.txt", [4], [0])
    images = list_images(scene / "dataset_train.txt")
    assert (images.layout, images.skipped, images.cameras) == ("Cambridge Landmarks", {}, [None] * 4)
    (scene / "intrinsics.json").write_text(json.dumps(INTRINSICS))
    assert [camera.fx if camera else None for camera in list_images(scene / "dataset_train.txt").cameras] == [29.25] * 4
    with pytest.raises(SequenceError, match=r"perhaps its dataset_train\.txt or dataset_test\.txt is meant"):
        list_images(scene)


def test_a_cambridge_sequence_is_named_by_its_folder_whichever_list_has_it(tmp_path: Path) -> None:
    scene = make_cambridge(tmp_path / "scene")
    check(scene / "seq10", [2, 3], [0, THIRTIETH_NS])
    check(scene / "seq1", [4], [0])
    write_images(scene, {6: "seq10/frame00003.png", 7: "seq3/frame00001.png"})
    assert list_images(scene / "seq10").skipped == {"image not in the list": 1}
    with pytest.raises(SequenceError, match="images without true poses"):
        list_images(scene / "seq3")
    (scene / "dataset_test.txt").write_text(HEADER + cambridge_row("seq10/frame00001.png", true_pose(2)))
    with pytest.raises(SequenceError, match=r"dataset_train\.txt:5: 'seq10/frame00001\.png' is on dataset_test\.txt:4"):
        list_images(scene / "seq10")


def test_a_published_cambridge_pose_looks_at_the_shop_and_stands_upright(tmp_path: Path) -> None:
    """Shop Façade, where the shop is at larger y and z is up; read the other way round, it would look away from it."""
    write_images(tmp_path, {0: "seq1/frame00001.png"})
    row = "seq1/frame00001.png -0.157816 -10.413150 1.832074 0.712261 0.682691 -0.123193 0.106962\n"
    (tmp_path / "dataset_test.txt").write_text(HEADER + row)
    pose = list_images(tmp_path / "dataset_test.txt").world_from_camera[0]
    np.testing.assert_allclose(pose.translation, [-0.157816, -10.413150, 1.832074])
    right, down, ahead = pose.rotation.T
    assert ahead[1] > 0.9
    assert down[2] < -0.9
    assert right[0] > 0.9


def test_what_a_cambridge_list_leaves_out_is_counted(tmp_path: Path) -> None:
    scene = make_cambridge(tmp_path / "scene")
    rows = [
        cambridge_row("seq2/frame00009.png", Poses(np.eye(3), np.array([3.1e9, -1.4e8, -1.2e9]))),
        cambridge_row("seq2/frame00010.png", true_pose(1)),
        "seq10/frame00001.png nan 0 0 1 0 0 0",
        cambridge_row("seq10/frame00007.png", true_pose(7)),
    ]
    (scene / "dataset_train.txt").write_text(HEADER + "\n".join(rows))
    check(scene / "dataset_train.txt", [1])
    assert list_images(scene / "dataset_train.txt").skipped == {
        "true pose more than 10 km away": 1,
        "true pose not finite": 1,
        "no image": 1,
        "image not in the list": 1,  # seq10/frame00002.png; those of seq1 are another split's
    }
    (scene / "dataset_train.txt").write_text(HEADER + cambridge_row("seq2/frame00010.png", true_pose(1)))
    assert list_images(scene / "dataset_train.txt").skipped == {"image not in the list": 3}  # of seq10 two


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (HEADER + "seq2/frame00009.png 1 2 3 1 0 0\n", "4: 7 columns, expected the 8 of `file tx ty tz qw qx qy qz`"),
        (HEADER + "seq2/frame00009.png 1 2 3 1 0 0 a\n", "4: 'a' is no number"),
        (HEADER + "seq2/frame00009.png 1 2 3 0 0 0 0\n", "4: quaternion of length 0, expected a unit quaternion"),
        (HEADER + "seq2/frame00009.png\n", "4: 1 columns"),
        (
            HEADER + "seq2/frame00009.png 1 2 3 1 0 0 0\n" * 2,
            r"5: 'seq2/frame00009.png' is on dataset_train\.txt:4 too",
        ),
        ("seq2/frame00009.png 1 2 3 1 0 0 0\n" * 5, "1: .* among the first three lines, expected them to be a header"),
    ],
)
def test_a_cambridge_list_that_is_wrong_is_named(content: str, said: str, tmp_path: Path) -> None:
    scene = make_cambridge(tmp_path / "scene")
    (scene / "dataset_train.txt").write_text(content)
    with pytest.raises(SequenceError, match=rf"dataset_train\.txt:{said}"):
        list_images(scene / "dataset_train.txt")
