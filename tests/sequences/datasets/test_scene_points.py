"""The sparse points of COLMAP models."""

import struct
from pathlib import Path

import numpy as np
import pytest

from sequences.datasets.points import scene_points
from sequences.errors import SequenceError
from tests.helpers.data_sets import make_colmap
from tests.helpers.dot_scene import make_colmap_binary

POINTS = ((7, (1.5, -2.0, 3.25), (255, 0, 10)), (900, (0.0, 1e3, -4.0), (1, 2, 3)))


def as_binary() -> bytes:
    rows = [struct.pack("<Q", len(POINTS))]
    for track, (number, position, color) in enumerate(POINTS):
        rows.append(struct.pack("<Q3d3BdQ", number, *position, *color, 0.5, track) + struct.pack("<ii", 4, 5) * track)
    return b"".join(rows)


def as_text() -> str:
    lines = ["# 3D point list with one line of data per point:"]
    for number, position, color in POINTS:
        lines.append(f"{number} {' '.join(map(str, [*position, *color]))} 0.5 1 20 3 40")
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("suffix", ["bin", "txt"])
def test_points_are_read_from_the_model_of_a_data_set(suffix: str, tmp_path: Path) -> None:
    if suffix == "bin":
        root = make_colmap_binary(tmp_path / "scene")
        (root / "sparse" / "0" / "points3D.bin").write_bytes(as_binary())
    else:
        root = make_colmap(tmp_path / "scene", "sparse", "images")
        (root / "sparse" / "points3D.txt").write_text(as_text())
    points = scene_points(root)
    assert points is not None
    np.testing.assert_array_equal(points.positions, [position for _, position, _ in POINTS])
    np.testing.assert_array_equal(points.colors, [color for _, _, color in POINTS])


def test_points_that_are_not_finite_are_left_out_and_a_model_without_points_has_none(tmp_path: Path) -> None:
    root = make_colmap(tmp_path / "scene", "sparse", "images")
    assert scene_points(root) is None
    (root / "sparse" / "points3D.txt").write_text(as_text() + "8 nan 0 0 1 2 3 0.5\n9 1 2 3 4 5 6 0.5\n")
    points = scene_points(root)
    assert points is not None
    np.testing.assert_array_equal(points.positions[2:], [[1, 2, 3]])
    (root / "sparse" / "points3D.txt").write_text("# none\n")
    points = scene_points(root)
    assert points is not None
    assert len(points) == 0


def test_damaged_points_are_refused_where_they_are(tmp_path: Path) -> None:
    root = make_colmap_binary(tmp_path / "b")
    (root / "sparse" / "0" / "points3D.bin").write_bytes(as_binary()[:-1])
    with pytest.raises(SequenceError, match=r"points3D.bin: ends at byte \d+ within a record"):
        scene_points(root)
    root = make_colmap(tmp_path / "t", "sparse", "images")
    for line, said in (("1 2 3", "3 columns, expected `POINT3D_ID X Y Z"), ("1 2 3 up 0 0 0 0", "'up' is no number")):
        (root / "sparse" / "points3D.txt").write_text(f"# a comment\n{line}\n")
        with pytest.raises(SequenceError, match=r"points3D.txt:2: ") as refused:
            scene_points(root)
        assert said in str(refused.value)
