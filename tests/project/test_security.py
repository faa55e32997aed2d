"""Files that are made to do harm: nothing in them is run, followed out of its folder, or unpacked into all memory."""

import ast
import json
import os
import struct
import zipfile
import zlib
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

ROOT = CHECKOUT
POSE = np.eye(4).tolist()


# --- nothing is run --------------------------------------------------------------------------------

_FORBIDDEN_MODULES = {"pickle", "cPickle", "dill", "cloudpickle", "marshal", "shelve", "subprocess", "pty", "commands"}
_FORBIDDEN_CALLS = {"eval", "exec", "compile", "__import__", "os.system", "os.popen", "yaml.unsafe_load", "joblib.load"}
_OWN = {  # no files: this package's own commands, and what a scheduler sends
    ROOT / "vapor" / "benchmark" / "live" / "faults.py": ["subprocess"],
    ROOT / "vapor" / "benchmark" / "live" / "measure.py": ["subprocess"],
    ROOT / "vapor" / "parallel" / "cluster.py": ["pickle"],
}
_REQUIRED = {"np.load": ("allow_pickle", False), "torch.load": ("weights_only", True)}


def dangers(source: str) -> list[str]:
    """What in a module could run what a file holds."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found += [each.name for each in node.names if each.name.split(".")[0] in _FORBIDDEN_MODULES]
        elif isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] in _FORBIDDEN_MODULES:
            found += [f"{node.module}.{each.name}" for each in node.names if not each.name.endswith("Error")]
        elif isinstance(node, ast.Call):
            name = ast.unparse(node.func)
            arguments = {keyword.arg: ast.unparse(keyword.value) for keyword in node.keywords}
            needed = _REQUIRED.get(name)
            loader = name == "yaml.load" and "SafeLoader" not in source
            if name in _FORBIDDEN_CALLS or name.startswith(("os.exec", "os.spawn")) or "shell" in arguments or loader:
                found.append(name)
            elif needed is not None and arguments.get(needed[0]) != str(needed[1]):
                found.append(f"{name} without {needed[0]}={needed[1]}")
    return found


@pytest.mark.parametrize(
    "source",
    [
        "import pickle",
        "from pickle import loads",
        "import subprocess as s",
        "eval('1')",
        "os.system('ls')",
        "run(x, shell=True)",
        "np.load(f)",
        "np.load(f, allow_pickle=True)",
        "torch.load(f)",
        "torch.load(f, weights_only=False)",
        "yaml.load(f, yaml.Loader)",
    ],
)
def test_what_could_run_a_file_is_noticed(source: str) -> None:
    assert dangers(source)


def test_no_package_runs_what_a_file_holds() -> None:
    files = [file for package in ("filtering", "sequences", "vapor") for file in (ROOT / package).rglob("*.py")]
    assert len(files) > 100
    assert {file: found for file in files if (found := dangers(file.read_text(encoding="utf-8")))} == _OWN


# --- names lead nowhere outside of the folder ------------------------------------------------------


def image(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(cv2.imencode(".png", np.zeros((48, 64, 3), np.uint8))[1].tobytes())
    return path


def tum(folder: Path, name: str) -> Path:
    (folder / "rgb.txt").write_text(f"1.0 rgb/1.png\n1.05 {name}\n")
    (folder / "groundtruth.txt").write_text("1.0 0 0 0 0 0 0 1\n1.1 0 0 0 0 0 0 1\n")
    image(folder / "rgb" / "1.png")
    return folder


def nerfstudio(folder: Path, name: str) -> Path:
    frames = [{"file_path": each, "transform_matrix": POSE} for each in ("rgb/1.png", name)]
    (folder / "transforms.json").write_text(json.dumps({"frames": frames, "fl_x": 50, "w": 64, "h": 48}))
    image(folder / "rgb" / "1.png")
    return folder


def colmap(folder: Path, name: str) -> Path:
    (folder / "cameras.txt").write_text("1 PINHOLE 64 48 50 50 32 24\n")
    (folder / "images.txt").write_text(f"1 1 0 0 0 0 0 0 1 rgb/1.png\n\n2 1 0 0 0 0 0 0 1 {name}\n\n")
    image(folder / "rgb" / "1.png")
    return folder


def cambridge(folder: Path, name: str) -> Path:
    rows = "".join(f"{each} 0 0 0 1 0 0 0\n" for each in ("rgb/1.png", name))
    (folder / "dataset_train.txt").write_text(f"a\nb\n\n{rows}")
    image(folder / "rgb" / "1.png")
    return folder / "dataset_train.txt"


def euroc(folder: Path, name: str) -> Path:
    camera, truth = folder / "mav0" / "cam0", folder / "mav0" / "state_groundtruth_estimate0"
    image(camera / "data" / "1.png")
    truth.mkdir()
    (camera / "data.csv").write_text(f"1000000000,1.png\n1050000000,{name}\n")
    (camera / "sensor.yaml").write_text(
        "T_BS: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]\nresolution: [64, 48]\nintrinsics: [50, 50, 32, 24]\n"
    )
    (truth / "data.csv").write_text("1000000000,0,0,0,1,0,0,0\n1100000000,0,0,0,1,0,0,0\n")
    return folder


NAMED = [tum, nerfstudio, colmap, cambridge, euroc]


@pytest.mark.parametrize("make", NAMED)
@pytest.mark.parametrize("how", ["absolute", "up", "link", "linked folder"])
def test_a_name_or_link_that_leads_out_of_a_data_set_is_refused(make, how: str, tmp_path: Path) -> None:
    outside = image(tmp_path / "private" / "secret.png")
    folder = tmp_path / "set"
    folder.mkdir()
    above = "../../../" if make is euroc else ""
    base = folder / "mav0" / "cam0" / "data" if make is euroc else folder
    name = {"absolute": str(outside), "up": f"{above}../private/secret.png", "link": "l.png"}.get(how, "l/secret.png")
    path = make(folder, name)
    if how == "link":
        os.symlink(outside, base / "l.png")
    elif how == "linked folder":
        os.symlink(outside.parent, base / "l")
    with pytest.raises(SequenceError, match="leads out of the folder, expected files that lie in it") as error:
        list_images(path)
    assert len(str(error.value)) <= 300


@pytest.mark.parametrize("make", NAMED)
def test_links_within_a_data_set_and_to_a_data_set_are_followed(make, tmp_path: Path) -> None:
    (tmp_path / "set").mkdir()
    path = make(tmp_path / "set", "l.png")
    base = tmp_path / "set" / ("mav0/cam0/data" if make is euroc else "rgb")
    os.symlink(base / "1.png", (base if make is euroc else tmp_path / "set") / "l.png")
    os.symlink(tmp_path / "set", tmp_path / "link")
    assert len(list_images(tmp_path / "link" / path.relative_to(tmp_path / "set"))) == 2


@pytest.mark.parametrize("make", NAMED)
@pytest.mark.parametrize("name", ["a" * 5000, "b/" * 3000 + "c"])
def test_a_name_of_5000_characters_is_an_image_that_is_not_there(make, name: str, tmp_path: Path) -> None:
    (tmp_path / "set").mkdir()
    assert list_images(make(tmp_path / "set", name)).skipped["no image"] == 1


def test_images_of_numbered_frames_that_link_out_are_refused(tmp_path: Path) -> None:
    outside = image(tmp_path / "private" / "secret.png")
    ceiling, scenes, record3d, stray = (tmp_path / name for name in ("ceiling", "7scenes", "record3d", "stray"))
    image(ceiling / "images" / "1.png")
    (ceiling / "poses.txt").write_text("0 1 0 0 0 1 0 0 0\n0 2 0 0 0 1 0 0 0\n")
    os.symlink(outside, ceiling / "images" / "2.png")
    scenes.mkdir()
    (scenes / "frame-000000.pose.txt").write_text("1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n")
    os.symlink(outside, scenes / "frame-000000.color.png")
    (record3d / "rgb").mkdir(parents=True)
    (record3d / "metadata.json").write_text('{"poses": [[0, 0, 0, 1, 0, 0, 0]], "fps": 30, "w": 64, "h": 48}')
    os.symlink(outside, record3d / "rgb" / "0.png")
    (stray / "rgb").mkdir(parents=True)
    (stray / "odometry.csv").write_text("timestamp, frame, x, y, z, qx, qy, qz, qw\n1, 0, 0, 0, 0, 0, 0, 0, 1\n")
    (stray / "camera_matrix.csv").write_text("50,0,32\n0,50,24\n0,0,1\n")
    os.symlink(outside, stray / "rgb" / "000000.png")
    for folder in (ceiling, scenes, record3d, stray):
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
    folder = tmp_path / "set"
    folder.mkdir()
    path = tum(folder, "rgb/1.png")
    (folder / "rgb" / "1.png").write_bytes(data)
    with pytest.raises(SequenceError, match=r"1\.png: .*pixels, expected at most"):
        list(posed_frames(path))


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
    path = euroc(tmp_path, "1.png")
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
