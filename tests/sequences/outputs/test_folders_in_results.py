"""Results that have folders in them: complete or absent, as files are."""

import os
from pathlib import Path

import pytest

from sequences.errors import SequenceError
from sequences.outputs import results_folder, verify


def write(directory: Path, *files: str, text: str = "new", overwrite: bool = False) -> None:
    with results_folder(directory, "map", writes=("images", "map.json"), overwrite=overwrite) as new:
        for file in files:
            (new / file).parent.mkdir(parents=True, exist_ok=True)
            (new / file).write_text(text)


def contents(directory: Path) -> dict[str, str]:
    files = (path for path in directory.rglob("*") if path.is_file() and path.name != "manifest.json")
    return {str(path.relative_to(directory)): path.read_text() for path in files}


def test_a_folder_is_replaced_as_one_and_checked(tmp_path):
    write(tmp_path / "out", "images/a/1", "images/a/2", "map.json", text="old")
    write(tmp_path / "out", "images/b/1", "map.json")
    assert contents(tmp_path / "out") == {"images/b/1": "new", "map.json": "new"}
    verify(tmp_path / "out", ["images"])
    (tmp_path / "out" / "images" / "b" / "2").write_text("mine")
    with pytest.raises(SequenceError, match="images: differs from what"):
        verify(tmp_path / "out", ["images"])


def test_a_folder_that_was_changed_is_never_lost(tmp_path):
    write(tmp_path / "out", "images/a/1", "map.json", text="old")
    (tmp_path / "out" / "images" / "a" / "mine").write_text("mine")
    before = contents(tmp_path / "out")
    with pytest.raises(SequenceError, match=r"holds images \(changed\)"):
        write(tmp_path / "out", "images/a/1")
    with pytest.raises(SequenceError, match="images: is a folder, not of unchanged results"):
        write(tmp_path / "out", "images/a/1", overwrite=True)
    assert contents(tmp_path / "out") == before


@pytest.mark.parametrize("fails_at", range(1, 6))
def test_where_replacing_fails_the_earlier_folder_comes_back(fails_at, tmp_path, monkeypatch):
    write(tmp_path / "out", "images/a/1", "map.json", text="old")
    rename, calls = os.rename, []

    def failing(source, target):
        calls.append(target)
        if len(calls) == fails_at:
            raise OSError(28, "No space left on device")
        rename(source, target)

    monkeypatch.setattr(os, "rename", failing)
    with pytest.raises(SequenceError, match="No space left"):
        write(tmp_path / "out", "images/b/1", "map.json", "more/1")
    assert contents(tmp_path / "out") == {"images/a/1": "old", "map.json": "old"}
    assert [entry.name for entry in (tmp_path / "out").iterdir() if entry.name.startswith(".")] == []
