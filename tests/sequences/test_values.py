"""What files say, read within limits."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from filtering.errors import MAX_MESSAGE, VaporTrackError, quoted
from sequences import files
from sequences.datasets.layout_helpers.image_files import find_camera
from sequences.errors import SequenceError
from sequences.estimates.pose_files import read_poses
from sequences.files import parse_json, read_arrays, read_lines
from sequences.frame import Camera
from sequences.recordings.serializations import decoder
from sequences.trajectories.pose_tables import read_pose_table
from sequences.trajectories.tum import read_tum
from sequences.values import is_number, natural, parse_number, parse_numbers, parse_time_ns
from vapor.checkpoints.stored_config import parse_metadata
from vapor.tensor_files import CheckpointError

CAMERA = Camera(64, 48, 50.0, 50.0, 31.5, 23.5)
REST = "0 0 0 0 0 0 1"
DEEP = "[" * 100_000 + "]" * 100_000
LONG = "9" * 5000


def refused(read, *said: str) -> None:
    """What is read is refused in one line of at most 1000 characters that says all of this."""
    with pytest.raises(VaporTrackError) as error:
        read()
    message = str(error.value)
    assert len(message) <= MAX_MESSAGE
    assert "\n" not in message
    for each in said:
        assert each in message


# --- stamps ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("1700000000000000000", "2116, expected seconds: are these nanoseconds?"),
        ("1700000000000000", "are these microseconds?"),
        ("1700000000000.5", "are these milliseconds?"),
        ("1e999999", "beyond the year 2116, expected seconds"),
        ("-1e99999999", "beyond the year 2116"),
        ("inf", "beyond the year 2116"),
        ("nan", "expected a number of seconds"),
        ("snan", "expected a number of seconds"),
        (LONG, "expected a number of seconds"),
        ("9" * 39 + "e99999999999999999", "expected a number of seconds"),
    ],
)
def test_stamps_that_no_clock_shows_are_refused_with_the_unit_that_they_may_be_in(text, said, tmp_path: Path) -> None:
    refused(lambda: parse_time_ns(text, "a.tum:7"), "a.tum:7: time", said)
    path = tmp_path / "a.tum"
    path.write_text(f"{text} {REST}\n")
    refused(lambda: read_tum(path), "a.tum:1: time", said)
    (tmp_path / "kitti.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n")
    (tmp_path / "times.txt").write_text(f"{text}\n")
    refused(lambda: read_pose_table(tmp_path / "kitti.txt"), "times.txt:1: time", said)


# --- numbers ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("text", ["1_0", "\u0663", "0.\u0665", "1_700_000_000.5"])
def test_what_only_python_takes_for_a_number_is_none(text: str) -> None:
    assert not is_number(text)
    refused(lambda: parse_number(text, "there"), "there is ")
    refused(lambda: parse_numbers(["1", text], "a.txt:3"), "a.txt:3: ", "is no number")
    refused(lambda: parse_time_ns(text, "a.tum:7"), "a.tum:7: time", "expected a number of seconds")


@settings(max_examples=60)
@given(st.one_of(st.text(max_size=400), st.floats(), st.integers(), st.none(), st.lists(st.integers())))
def test_a_number_is_within_its_range_or_an_error_in_one_line(value) -> None:
    try:
        found = parse_number(value, "there", -2.0, 3.0)
    except SequenceError:
        refused(lambda: parse_number(value, "there", -2.0, 3.0), "there is ")
    else:
        assert -2.0 <= found <= 3.0


@pytest.mark.parametrize("row", ["0 0 1e13 0 0 0 1", "0 0 0 1e300 0 0 1", f"0 {LONG} 0 0 0 0 1"])
def test_poses_beyond_all_places_are_refused(row: str, tmp_path: Path) -> None:
    (tmp_path / "a.tum").write_text(f"1 {REST}\n2 {row}\n")
    refused(lambda: read_tum(tmp_path / "a.tum"), "a.tum:2: ", "beyond 1e+12")
    (tmp_path / "p.txt").write_text(f"frame-1 {row}\n")
    refused(lambda: read_poses(tmp_path / "p.txt", "camera-to-world"), "p.txt:1: ", "beyond 1e+12")


def test_names_with_numbers_of_5000_digits_are_refused_or_sorted(tmp_path: Path) -> None:
    (tmp_path / "p.txt").write_text(f"seq/frame-{LONG}.png 1 0 0 0 0 0 0\n")
    refused(lambda: read_poses(tmp_path / "p.txt", "camera-to-world"), "p.txt:1: number of a frame: '9999")
    (tmp_path / "p.txt").write_text(f"{LONG}/frame-1.png 1 0 0 0 0 0 0\nseq/frame-1.png 1 0 0 0 0 0 0\n")
    assert len(read_poses(tmp_path / "p.txt", "camera-to-world").frames) == 2


@given(st.lists(st.integers(0, 10**30), max_size=8), st.sampled_from(["", "0", "00"]))
def test_numbers_in_names_sort_as_numbers(numbers: list[int], zeros: str) -> None:
    names = sorted((f"a{zeros}{number}b" for number in numbers), key=natural)
    assert [int(name[1:-1]) for name in names] == sorted(numbers)


# --- cameras ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("fx", "NaN", "fx is nan"),
        ("fy", "-300", "fy -300"),
        ("fy", "0", "fy 0"),
        ("width", "0", "width 0"),
        ("width", "NaN", "width is nan"),
        ("height", "Infinity", "height is inf"),
        ("height", "1e999", "height is inf"),
        ("width", "1e9", "width 1000000000"),
        ("width", "1" + "0" * 400, "integer of 401 digits"),
        ("cx", LONG, "integer of 5000 digits"),
        ("cy", '"south"', "cy is 'south'"),
        ("cy", "true", "cy is True"),
        ("cx", "null", "cx is None"),
        ("cx", DEEP, "nested too deeply"),
    ],
)
def test_intrinsics_that_no_camera_has_are_refused(name: str, value: str, said: str, tmp_path: Path) -> None:
    stated = {"width": "64", "height": "48", "fx": "50", "fy": "50", "cx": "31", "cy": "23"} | {name: value}
    content = ", ".join(f'"{key}": {text}' for key, text in stated.items())
    (tmp_path / "intrinsics.json").write_text(f"{{{content}}}")
    refused(lambda: find_camera([tmp_path], []), "intrinsics.json: ", said)


@pytest.mark.parametrize(
    "change",
    [{"fx": np.nan}, {"fy": -300.0}, {"width": 0}, {"height": -1}, {"width": 10**400}, {"cx": np.inf}, {"fx": 1e300}],
)
def test_no_camera_is_made_of_what_none_has(change: dict) -> None:
    refused(lambda: replace(CAMERA, **change), f"camera with {next(iter(change))} ")


# --- JSON ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (DEEP, "nested too deeply"),
        ("[" * 65 + "]" * 65, "nested too deeply, expected JSON of at most 64 levels"),
        ('{"a":' * 100_000, "nested too deeply"),
        (LONG, "an integer of 5000 digits"),
        ('{"a": ', "expected JSON"),
        (b"\xff\xfe{", "expected JSON"),
    ],
)
def test_json_beyond_its_limits_is_refused_wherever_it_is_read(text: str | bytes, said: str, tmp_path: Path) -> None:
    refused(lambda: parse_json(text, "there"), "there: ", said)
    data = text if isinstance(text, bytes) else text.encode()
    refused(lambda: decoder("foxglove.PoseInFrame", "json", b"")(data), said)
    if isinstance(text, str):
        with pytest.raises(CheckpointError, match=said):
            parse_metadata(tmp_path / "model.safetensors", text)


def test_json_of_64_levels_is_read_and_of_a_message_gives_fields() -> None:
    assert parse_json("[" * 64 + "]" * 64, "")
    data = {"pose": {"position": {"x": 1, "y": 2, "z": 3}, "orientation": {"x": 0, "y": 0, "z": 0, "w": 1}}}
    data |= {"timestamp": {"sec": 1, "nsec": 2}, "frame_id": "map"}
    message = decoder("foxglove.PoseInFrame", "json", b"")(json.dumps(data).encode())
    assert message.pose.position == SimpleNamespace(x=1.0, y=2.0, z=3.0)


# --- files -----------------------------------------------------------------------------------------


def test_files_and_lines_that_are_too_large_are_refused_before_they_are_read(tmp_path: Path) -> None:
    path = tmp_path / "a.tum"
    with open(path, "wb") as file:
        file.truncate((256 << 20) + 1)  # takes no room on the disk
    refused(lambda: read_tum(path), "a.tum: more than 268,435,456 bytes")
    path.write_text(f"1 {REST}\n" + "2 " * (8 << 20))
    refused(lambda: read_tum(path), "a.tum:2: more than 16,777,216 bytes, expected a shorter line")


def test_lines_are_numbered_as_an_editor_numbers_them(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes("a\r\n\n b\u2028c \x0b\nlast".encode())
    assert list(read_lines(tmp_path / "a")) == [(1, "a"), (2, ""), (3, " b\u2028c \x0b"), (4, "last")]


def test_arrays_of_objects_and_damaged_ones_are_refused(monkeypatch, tmp_path: Path) -> None:
    np.savez(tmp_path / "objects.npz", a=np.array([{}], object))
    refused(lambda: read_arrays(tmp_path / "objects.npz"), "objects.npz: cannot be read", "allow_pickle")
    np.savez_compressed(tmp_path / "zeros.npz", a=np.zeros(100_000))
    monkeypatch.setattr(files, "_MAX_ARRAYS", 100_000)
    refused(lambda: read_arrays(tmp_path / "zeros.npz"), "zeros.npz: arrays of 800,")
    (tmp_path / "cut.npz").write_bytes((tmp_path / "zeros.npz").read_bytes()[:-30])
    refused(lambda: read_arrays(tmp_path / "cut.npz"), "cut.npz: cannot be read")


# --- messages --------------------------------------------------------------------------------------


def test_messages_stay_short_whatever_they_quote() -> None:
    for value in ("x" * 10**6, 10**5000, [[[[[[[]]]]]]], list(range(10**5)), b"\0" * 10**6, {"a" * 999: "b" * 999}):
        assert len(quoted(value)) <= 60
    assert quoted("two\nlines\x1b") == r"'two\nlines\x1b'"
    message = str(VaporTrackError("/a/long" * 50 + "/end.tum:3: " + "x " * 500 + "expected numbers"))
    assert len(message) <= MAX_MESSAGE
    assert "/end.tum:3: " in message
    assert message.endswith("expected numbers")
    whole = "/" + "a" * 100 + ": is short enough"
    assert str(VaporTrackError(whole)) == whole
