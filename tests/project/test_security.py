"""Files that are made to do harm: nothing in them is run, followed out of its folder, or unpacked into all memory."""

import os
import re
import struct
import zipfile
import zlib
from collections.abc import Callable
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest

from sequences.datasets.frames import posed_frames
from sequences.datasets.layout_helpers.packed import Archive
from sequences.datasets.listing import list_images
from sequences.errors import SequenceError
from sequences.images.decoding import decode_image_bytes
from sequences.images.headers import DamagedImageError, stated_size
from sequences.recordings.bag import bag_files
from tests.helpers.checkout import CHECKOUT
from tests.helpers.data_sets import make_7scenes, make_cambridge, make_ceiling, make_colmap, make_tum
from tests.helpers.dot_scene import make_euroc, make_nerfstudio, make_record3d_export, make_stray, r3d_metadata

# --- nothing is run --------------------------------------------------------------------------------


def test_no_package_unpickles_arrays_or_weights() -> None:
    """The rules of ruff in pyproject.toml forbid the rest: pickle, eval, exec, shells, and loaders of unsafe YAML."""
    files = [file for package in ("filtering", "sequences", "vapor") for file in (CHECKOUT / package).rglob("*.py")]
    assert len(files) > 100
    unsafe = re.compile(r"allow_pickle=(?!False)|weights_only=(?!True)")
    assert [file for file in files if unsafe.search(file.read_text(encoding="utf-8"))] == []


# --- names lead nowhere outside of the folder ------------------------------------------------------


# Data sets whose files name their images: how to make one, the file, and the folder that names are relative to.
NAMING = {
    "tum": (make_tum, "rgb.txt", "."),
    "nerfstudio": (make_nerfstudio, "transforms.json", "."),
    "colmap": (lambda folder: make_colmap(folder, "sparse/0", "images"), "sparse/0/images.txt", "images"),
    "cambridge": (make_cambridge, "dataset_train.txt", "."),
    "euroc": (make_euroc, "mav0/cam0/data.csv", "mav0/cam0/data"),
}
NUMBERED = [
    *(make_7scenes, partial(make_stray, video=False), lambda folder: make_ceiling(folder) / "train"),
    lambda folder: make_record3d_export(folder, r3d_metadata()),
]


def with_name(layout: str, folder: Path, named: Callable[[Path], str]) -> Path:
    """A data set in which one image has another name, a function of the folder that names are relative to; its path."""
    make, listing, base = NAMING[layout]
    make(folder)
    text = (folder / listing).read_text()
    *_, last = re.finditer(r"[\w./-]+\.png", text)
    (folder / listing).write_text(text[: last.start()] + named(folder / base) + text[last.end() :])
    return {"colmap": folder / "sparse" / "0", "cambridge": folder / listing}.get(layout, folder)


@pytest.fixture
def outside(tmp_path: Path) -> Path:
    """An image that is in no data set."""
    path = tmp_path / "private" / "secret.png"
    path.parent.mkdir()
    path.write_bytes(cv2.imencode(".png", np.zeros((48, 64, 3), np.uint8))[1].tobytes())
    return path


@pytest.mark.parametrize("layout", NAMING)
@pytest.mark.parametrize("how", ["absolute", "up", "link", "linked folder"])
def test_a_name_or_link_that_leads_out_of_a_data_set_is_refused(
    layout: str, how: str, outside: Path, tmp_path: Path
) -> None:
    def named(base: Path) -> str:
        os.symlink(outside, base / "l.png")
        os.symlink(outside.parent, base / "l")
        up = os.path.relpath(outside, base)
        return {"absolute": str(outside), "up": up, "link": "l.png", "linked folder": "l/secret.png"}[how]

    path = with_name(layout, tmp_path / "set", named)
    with pytest.raises(SequenceError, match="leads out of the folder, expected files that lie in it") as error:
        list_images(path)
    assert len(str(error.value)) <= 300


@pytest.mark.parametrize("layout", NAMING)
def test_links_within_a_data_set_and_to_a_data_set_are_followed(layout: str, tmp_path: Path) -> None:
    def named(base: Path) -> str:
        os.symlink(next(base.rglob("*.png")), base / "l.png")
        return "l.png"

    path = with_name(layout, tmp_path / "set", named)
    os.symlink(tmp_path / "set", tmp_path / "link")
    listed = list_images(tmp_path / "link" / path.relative_to(tmp_path / "set"))
    assert len(listed) > 1
    assert "no image" not in listed.skipped


@pytest.mark.parametrize("layout", NAMING)
@pytest.mark.parametrize("name", ["a" * 5000, "b/" * 3000 + "c"])
def test_a_name_of_5000_characters_is_an_image_that_is_not_there(layout: str, name: str, tmp_path: Path) -> None:
    assert list_images(with_name(layout, tmp_path / "set", lambda _: name)).skipped["no image"] == 1


@pytest.mark.parametrize("make", NUMBERED)
def test_images_of_numbered_frames_that_link_out_are_refused(make, outside: Path, tmp_path: Path) -> None:
    folder = make(tmp_path / "set")
    replaced = next(path for path in sorted(folder.rglob("*")) if path.suffix in (".png", ".jpg"))
    replaced.unlink()
    os.symlink(outside, replaced)
    with pytest.raises(SequenceError, match="leads out of the folder"):
        list_images(folder)


@pytest.mark.parametrize("name", ["/etc/a.mcap", "../a.mcap", "link.mcap"])
def test_the_list_of_a_rosbag2_leads_to_no_file_outside_of_it(name: str, tmp_path: Path) -> None:
    outside, bag = tmp_path / "a.mcap", tmp_path / "bag"
    outside.touch()
    bag.mkdir()
    os.symlink(outside, bag / "link.mcap")
    name = str(outside) if name.startswith("/") else name
    (bag / "metadata.yaml").write_text(f"rosbag2_bagfile_information:\n  relative_file_paths:\n    - {name}\n")
    with pytest.raises(SequenceError, match="leads out of the folder"):
        bag_files(bag)


# --- what unpacks to more than there is memory -----------------------------------------------------


def png(width: int, height: int) -> bytes:
    """A PNG whose header states a size that nothing in it fills."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    parts = chunk(b"IHDR", header), chunk(b"IDAT", zlib.compress(bytes(10**6))), chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


def jpeg(width: int, height: int) -> bytes:
    """A JPEG whose header states that size in place of 64 x 48."""
    data = cv2.imencode(".jpg", np.zeros((48, 64, 3), np.uint8))[1].tobytes()
    assert data.count(struct.pack(">HH", 48, 64)) == 1
    return data.replace(struct.pack(">HH", 48, 64), struct.pack(">HH", height, width))


def test_a_png_with_a_chunk_longer_than_itself_is_not_decoded(monkeypatch) -> None:
    monkeypatch.setattr(cv2, "imdecode", lambda *_: pytest.fail("memory was asked for"))
    whole = png(640, 480)
    for damaged in (whole[:33] + b"\x7f\xff\xff\xff" + whole[37:], whole[:-12], whole[:60]):
        with pytest.raises(DamagedImageError, match=rf"PNG of {len(damaged)} bytes is cut off or broken"):
            decode_image_bytes(damaged)


@pytest.mark.parametrize("data", [png(30_000, 30_000), png(2**31 - 1, 2**31 - 1), jpeg(30_000, 30_000)])
def test_an_image_that_says_it_is_larger_than_any_is_not_decoded(data: bytes, monkeypatch, tmp_path: Path) -> None:
    monkeypatch.setattr(cv2, "imdecode", lambda *_: pytest.fail("memory was asked for"))
    with pytest.raises(SequenceError, match=r"30000 x 30000 pixels, expected at most|2147483647 x 2147483647 pixels"):
        decode_image_bytes(data)
    folder = make_tum(tmp_path / "set", num_images=1)
    next(folder.glob("rgb/*.png")).write_bytes(data)
    with pytest.raises(SequenceError, match=r"\.png: .*pixels, expected at most"):
        list(posed_frames(folder))


def test_the_size_of_an_image_is_that_which_is_decoded() -> None:
    pixels = np.random.default_rng(0).integers(0, 255, (31, 57, 3), np.uint8)
    for suffix, options in ((".png", []), (".jpg", []), (".jpg", [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])):
        data = cv2.imencode(suffix, pixels, options)[1].tobytes()
        assert stated_size(data) == (57, 31)
        # A thumbnail of another size within a segment before the frame is passed over.
        if suffix == ".jpg":
            thumbnail = jpeg(500, 500)
            segment = b"\xff\xe1" + struct.pack(">H", len(thumbnail) + 2) + thumbnail
            assert stated_size(data[:2] + segment + data[2:]) == (57, 31)
    assert stated_size(b"BM....") is None
    assert stated_size(b"\xff\xd8\xff") is None


def test_a_member_of_an_archive_that_unpacks_to_gigabytes_is_not_unpacked(monkeypatch, tmp_path: Path) -> None:
    path = tmp_path / "scan.r3d"
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("metadata", "w", force_zip64=True) as out,
    ):
        for _ in range(65):
            out.write(bytes(1 << 20))
    assert path.stat().st_size < 1 << 20
    monkeypatch.setattr(zipfile.ZipFile, "read", lambda *_: pytest.fail("memory was asked for"))
    with pytest.raises(SequenceError, match=r"scan\.r3d: 'metadata' has 68,157,440 bytes, expected at most 67,108,864"):
        list_images(path)
    assert Archive(path).names == {"metadata"}


def test_an_archive_whose_names_are_no_text_or_that_is_of_a_later_version_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "scan.r3d"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("métadonnées", b"{}")
    whole = path.read_bytes()
    entry = whole.rindex(b"PK\x01\x02")
    for damaged in (
        whole[: entry + 46] + whole[entry + 46 :].replace("é".encode(), b"\xd3a"),
        whole[: entry + 6] + b"\xff" + whole[entry + 7 :],
    ):
        path.write_bytes(damaged)
        with pytest.raises(SequenceError, match=r"scan\.r3d: cannot be read as a zip archive"):
            Archive(path)


def test_yaml_whose_references_multiply_is_refused(tmp_path: Path) -> None:
    path = make_euroc(tmp_path / "set")
    bomb = "a: &a [1, 1]\n" + "".join(
        f"{chr(98 + i)}: &{chr(98 + i)} [*{chr(97 + i)}, *{chr(97 + i)}]\n" for i in range(24)
    )
    for content, said in (
        (f"{bomb}T_BS: *y\n", "refers to values by names"),
        ("T_BS: " + "[" * 5000, "expected YAML"),
        (f"T_BS: {'9' * 5000}", "expected YAML"),
        ("#" * (1 << 17), "more than 65,536 bytes"),
    ):
        (path / "mav0" / "cam0" / "sensor.yaml").write_text(content)
        with pytest.raises(SequenceError, match=said) as error:
            list_images(path)
        assert len(str(error.value)) <= 300
