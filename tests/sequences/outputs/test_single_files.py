"""Single files: which are replaced, and which are refused."""

import os
from pathlib import Path

import pytest

from sequences.atomic import atomic_output
from sequences.errors import SequenceError
from sequences.outputs import refuse_other
from tests.helpers.results import write


def test_a_file_is_only_replaced_by_its_kind(tmp_path):
    path = tmp_path / "model"

    def ours(file: Path) -> bool:
        return file.read_text() == "model"

    refuse_other(path, "model", ours)
    path.write_text("thesis")
    with pytest.raises(SequenceError, match="exists and is no model, expected a new file or one; --overwrite"):
        refuse_other(path, "model", ours)
    refuse_other(path, "model", ours, overwrite=True)
    path.write_text("model")
    refuse_other(path, "model", ours)
    with pytest.raises(SequenceError, match="is read"):
        refuse_other(path, "model", ours, reads=[tmp_path / "." / "model"], overwrite=True)


def test_what_lies_in_a_folder_that_is_read_is_only_replaced_by_its_kind(tmp_path):
    (tmp_path / "image").write_text("image")
    (tmp_path / "model").write_text("model")

    def check(name: str, read: Path) -> None:
        refuse_other(tmp_path / name, "model", lambda file: file.name == "model", reads=[read], overwrite=True)

    for name in ("model", "new"):
        check(name, tmp_path)
    check("image", tmp_path / "other")
    with pytest.raises(SequenceError, match=r"image: lies in .*, which is read, and is no model; expected another"):
        check("image", tmp_path)


def test_a_file_of_results_is_not_replaced_by_another_of_its_kind(tmp_path):
    write(tmp_path, "first")
    with pytest.raises(SequenceError, match="belongs to the results"):
        refuse_other(tmp_path / "b.json", "report", lambda _: True)


def test_a_link_to_a_file_stays_one_and_devices_stay_devices(tmp_path):
    (tmp_path / "real").write_text("before")
    (tmp_path / "link").symlink_to("real")
    with atomic_output(tmp_path / "link") as partial:
        partial.write_text("after")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "real").read_text() == "after"
    with pytest.raises(SequenceError, match="not a regular file"), atomic_output(Path(os.devnull)):
        pytest.fail("the work began")
