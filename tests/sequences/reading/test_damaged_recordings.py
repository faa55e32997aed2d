"""Files and folders that are refused, and damage anywhere in them."""

from pathlib import Path

import numpy as np
import pytest

from sequences.errors import SequenceError
from sequences.reader import SequenceReader
from tests.helpers.sequence_files import FORMS, Form, close, world_from_camera


def test_a_recording_cut_off_is_refused_when_opened(walk_file: Path, tmp_path: Path) -> None:
    data = walk_file.read_bytes()
    for size in (len(data) - 1, len(data) // 2, 20):
        path = tmp_path / "cut.mcap"
        path.write_bytes(data[:size])
        with pytest.raises(SequenceError, match=r"cut\.mcap: truncated: byte \d+ of \d+.*closing MCAP magic"):
            SequenceReader(path)


@pytest.mark.parametrize("content", [b"garbage" * 100, bytes(500)])
def test_garbage_is_refused_by_its_first_bytes(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "garbage.mcap"
    path.write_bytes(content)
    with pytest.raises(SequenceError, match=r"garbage\.mcap: starts with .*expected the MCAP magic"):
        SequenceReader(path)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("form", [form for form in FORMS if form.__name__ != "as_split_folder"])
def test_damage_anywhere_is_an_error_that_names_the_file_or_does_no_harm(
    form: Form, walk_file: Path, tmp_path: Path
) -> None:
    recording = form(walk_file, tmp_path)
    path = recording if recording.is_file() else next(recording.glob("*.db3"))
    data = path.read_bytes()
    reference = list(SequenceReader(recording))
    has_checksums = form.__name__ in ("as_file", "as_file_without_index")
    rng = np.random.default_rng(0)
    refusals = []
    for start in rng.integers(8, len(data) - 60, 30):
        damaged = bytearray(data)
        damaged[start : start + 40] = rng.integers(0, 256, 40, dtype=np.uint8).tobytes()
        path.write_bytes(damaged)
        try:
            frames = list(SequenceReader(recording))
        except SequenceError as error:
            refusals.append(str(error))
        else:
            # The chunks of MCAP have checksums: what is not noticed is what is not read.
            if has_checksums:
                for frame, expected in zip(frames, reference, strict=True):
                    np.testing.assert_array_equal(frame.image, expected.image)
                    assert close(frame.world_from_camera, world_from_camera(frame.time_ns))
    assert len(refusals) >= (5 if has_checksums else 3)
    assert all(recording.name in refusal and "\n" not in refusal for refusal in refusals)


def test_a_folder_must_be_a_rosbag2_with_its_files(walk_file: Path, tmp_path: Path) -> None:
    with pytest.raises(SequenceError, match=r"no metadata\.yaml"):
        SequenceReader(tmp_path)
    listing = tmp_path / "metadata.yaml"
    for text, said in [
        ("version: 5\n", "names no files"),
        ("relative_file_paths:\n- gone.mcap\n", r"gone\.mcap', which is not in the folder"),
        ("relative_file_paths:\n- bag_0.txt\n", r"bag_0\.txt', expected \.mcap or \.db3"),
        (
            "relative_file_paths:\n- bag_0.db3.zstd\n",
            r"bag_0\.db3\.zstd', a file packed as a whole; unpack it first: `zstd -d`",
        ),
    ]:
        listing.write_text(text)
        with pytest.raises(SequenceError, match=said):
            SequenceReader(tmp_path)


def test_a_file_that_is_missing_is_named(tmp_path: Path) -> None:
    with pytest.raises(SequenceError, match=r"nowhere\.mcap: no such file"):
        SequenceReader(tmp_path / "nowhere.mcap")
