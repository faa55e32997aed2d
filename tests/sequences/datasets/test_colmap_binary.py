"""COLMAP's binary model -> images, poses and cameras."""

from collections.abc import Callable
from pathlib import Path

import pytest

from sequences.datasets.listing import list_images
from tests.helpers.dot_checks import THIRTIETHS, check, check_conversion, refuse
from tests.helpers.phone_data_sets import NUM, make_colmap_binary


def test_a_binary_colmap_model_gives_what_it_says(tmp_path: Path) -> None:
    root = make_colmap_binary(tmp_path / "scene")
    check(root, list(range(NUM)), THIRTIETHS, within_px=0.4)
    assert list_images(root).layout == "COLMAP"
    (root / "sparse" / "0" / "images.txt").write_text("stale")
    (root / "sparse" / "0" / "cameras.txt").write_text("stale")
    check_conversion(root, tmp_path, list(range(NUM)), within_px=0.4)


@pytest.mark.parametrize(
    ("file", "change", "said"),
    [
        ("images.bin", lambda data: data[:-1], "images.bin: ends at byte"),
        ("images.bin", lambda data: data[:30], "images.bin: ends at byte 30 within a record"),
        ("images.bin", lambda data: data[:8] + data[8:].replace(b"\0", b"\1"), "images.bin: ends at byte"),
        ("images.bin", lambda data: b"", "images.bin: ends at byte 0 within a record"),
        ("images.bin", lambda data: data.replace("ü".encode(), b"\xff\xff"), "is no UTF-8 text"),
        ("images.bin", lambda data: data.replace(b"9 b.png", b"8 b.png"), "8 b.png' is image 2 too, expected it once"),
        (
            "cameras.bin",
            lambda data: data[:12] + b"\x63" + data[13:],
            "cameras.bin:1: camera model 99 is unknown, expected 0 to 19 (BROWN_CONRADY); PINHOLE cameras are made by",
        ),
        ("cameras.bin", lambda data: data[:-8], "cameras.bin: ends at byte"),
        ("cameras.bin", lambda data: data[:8] + b"\x08" + data[9:], "camera '7', expected one of those in cameras.bin"),
    ],
)
def test_what_is_wrong_with_a_binary_colmap_model_is_said(
    file: str, change: Callable[[bytes], bytes], said: str, tmp_path: Path
) -> None:
    root = make_colmap_binary(tmp_path / "scene")
    path = root / "sparse" / "0" / file
    path.write_bytes(change(path.read_bytes()))
    refuse(root, said)
