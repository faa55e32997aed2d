"""Results are only ever replaced by results, whole: what folders and single files refuse, and what they keep."""

import json
import os
from pathlib import Path

import pytest

from sequences.atomic import NEW, atomic_output
from sequences.errors import SequenceError
from sequences.outputs import MANIFEST, claim_folder, read_manifest, refuse_other, verify
from tests.helpers.results import WRITES, contents, interrupt, refused, whole, write


def test_results_appear_with_a_manifest_and_are_replaced_as_one(tmp_path):
    out = tmp_path / "deep" / "out"
    write(out, "first", sometimes=True)
    assert set(contents(out)) == {*WRITES, MANIFEST}
    manifest = read_manifest(out)
    assert manifest["command"] == "run"
    assert manifest["files"]["a.tum"].size == 5
    write(out, "second")
    assert whole(out) == "second"
    assert set(contents(out)) == {"a.tum", "b.json", MANIFEST}
    assert os.listdir(out.parent) == ["out"]


def test_an_error_on_the_way_leaves_nothing_of_new_folders_and_all_of_old_ones(tmp_path):
    write(tmp_path / "old", "first")
    for out in (tmp_path / "deep" / "new", tmp_path / "old"):
        with pytest.raises(KeyboardInterrupt):
            write(out, "half", meanwhile=interrupt)
    assert os.listdir(tmp_path) == ["old"]
    assert whole(tmp_path / "old") == "first"


def test_a_folder_with_files_of_the_users_is_refused_and_names_what_it_holds(tmp_path):
    mine = {"seq.mcap": "images", "a.tum": "my truth", "b.json": "{}", "notes.txt": "mine"}
    for name, text in mine.items():
        (tmp_path / name).write_text(text)
    refused(tmp_path, "a.tum, b.json, notes.txt and seq.mcap", "--overwrite")
    write(tmp_path, "new", overwrite=True)
    assert contents(tmp_path).items() >= {"seq.mcap": "images", "notes.txt": "mine", "a.tum": "new"}.items()
    assert read_manifest(tmp_path)["files"].keys() == {"a.tum", "b.json"}


def test_results_with_a_note_or_a_change_of_the_users_are_refused(tmp_path):
    out = tmp_path / "out"
    write(out, "first", sometimes=True)
    (out / "notes.txt").write_text("mine")
    refused(out, "holds notes.txt,")
    (out / "sometimes.png").write_text("FIRST")
    refused(out, "notes.txt and sometimes.png (changed)")
    write(out, "second", overwrite=True)
    assert contents(out)["notes.txt"] == "mine"
    assert contents(out)["sometimes.png"] == "FIRST"  # no longer what was listed, and not written anew
    assert contents(out)["a.tum"] == "second"


def test_with_overwrite_files_of_the_earlier_manifest_go_and_no_others(tmp_path):
    write(tmp_path, "first", sometimes=True)
    (tmp_path / "notes.txt").write_text("mine")
    write(tmp_path, "second", overwrite=True)
    assert set(contents(tmp_path)) == {"a.tum", "b.json", "notes.txt", MANIFEST}
    assert whole(tmp_path) == "second"


def test_what_is_read_is_never_replaced(tmp_path):
    out = tmp_path / "out"
    write(out, "first", sometimes=True)
    refused(out, "sometimes.png (which is read)", reads=[out / "sometimes.png"])
    refused(out, "is read", reads=[out / "sometimes.png"], overwrite=True)
    refused(out, "is read", reads=[out], overwrite=True)
    (out / "b.json").write_text("mine")
    refused(out, "b.json: is read", reads=[tmp_path], overwrite=True)
    (out / "b.json").write_text("first")
    (out / "poses.txt").write_text("truth")
    write(out, "second", reads=[out / "poses.txt"], overwrite=True)
    assert contents(out)["poses.txt"] == "truth"


def test_links_are_followed_unless_they_lead_nowhere(tmp_path):
    (tmp_path / "link").symlink_to("real")
    refused(tmp_path / "link", "is a link to real, which does not exist")
    with pytest.raises(SequenceError, match="link to real"), atomic_output(tmp_path / "link"):
        pytest.fail("the work began")
    (tmp_path / "real").mkdir()
    for content in ("first", "second"):
        write(tmp_path / "link", content)
        assert whole(tmp_path / "real") == content
    assert (tmp_path / "link").is_symlink()


def test_a_file_and_a_folder_in_the_place_of_a_file_are_refused(tmp_path):
    (tmp_path / "file").write_text("mine")
    refused(tmp_path / "file", "is a file")
    (tmp_path / "out" / "a.tum").mkdir(parents=True)
    refused(tmp_path / "out", "a.tum: is a folder", overwrite=True)


def test_results_in_the_working_directory_are_replaced_within_it(tmp_path, monkeypatch):
    write(tmp_path, "first", sometimes=True)
    monkeypatch.chdir(tmp_path)
    folder = os.stat(".").st_ino
    write(Path("."), "second")
    assert os.stat(tmp_path).st_ino == folder
    assert whole(tmp_path) == "second"
    assert set(os.listdir(tmp_path)) == {"a.tum", "b.json", MANIFEST}


def test_a_folder_that_somebody_makes_during_the_work_is_written_to(tmp_path):
    def make() -> None:
        (tmp_path / "out").mkdir()
        (tmp_path / "out" / "notes.txt").write_text("mine")

    write(tmp_path / "out", "first", meanwhile=make)
    assert whole(tmp_path / "out") == "first"
    assert contents(tmp_path / "out")["notes.txt"] == "mine"
    assert os.listdir(tmp_path) == ["out"]


def test_a_file_that_a_user_adds_during_the_work_is_not_lost(tmp_path):
    write(tmp_path / "out", "first")
    write(tmp_path / "out", "second", meanwhile=lambda: (tmp_path / "out" / "notes.txt").write_text("mine"))
    assert contents(tmp_path / "out")["notes.txt"] == "mine"
    assert whole(tmp_path / "out") == "second"
    (tmp_path / "out" / "notes.txt").unlink()
    with pytest.raises(SequenceError, match=r"a\.tum: was written meanwhile"):
        write(tmp_path / "out", "third", meanwhile=lambda: (tmp_path / "out" / "a.tum").write_text("mine"))
    assert contents(tmp_path / "out")["a.tum"] == "mine"


@pytest.mark.parametrize(
    "text", ["{}", "[1]", "no json", '{"format": "vapor-track results", "version": 1, "files": 3}']
)
def test_a_manifest_of_someone_else_is_a_file_like_any_other(text, tmp_path):
    (tmp_path / MANIFEST).write_text(text)
    refused(tmp_path, MANIFEST)
    with pytest.raises(SequenceError, match="manifest"):
        verify(tmp_path, WRITES)


def test_a_manifest_cannot_name_files_of_other_folders(tmp_path):
    (tmp_path / "precious").write_text("first")
    write(tmp_path / "out", "first")
    manifest = json.loads((tmp_path / "out" / MANIFEST).read_text())
    manifest["files"]["../precious"] = manifest["files"].pop("a.tum")
    (tmp_path / "out" / MANIFEST).write_text(json.dumps(manifest))
    refused(tmp_path / "out", "a.tum")
    write(tmp_path / "out", "second", overwrite=True)
    assert (tmp_path / "precious").read_text() == "first"


def test_a_file_that_differs_from_its_manifest_or_is_missing_is_named(tmp_path):
    write(tmp_path, "first")
    verify(tmp_path, WRITES)
    (tmp_path / "a.tum").write_text("FIRST")
    verify(tmp_path, ["b.json"])
    with pytest.raises(SequenceError, match=r"a\.tum: differs"):
        verify(tmp_path, WRITES)
    (tmp_path / "b.json").unlink()
    with pytest.raises(SequenceError, match=r"b\.json: missing"):
        verify(tmp_path, ["b.json"])


def test_what_a_killed_process_left_deep_in_a_folder_that_grows_is_cleared_away(tmp_path):
    claim_folder(tmp_path / "bench", "vapor-benchmark faults")
    (tmp_path / "bench" / "trials" / ".walk.json.0123abcd.partial" / NEW).mkdir(parents=True)
    claim_folder(tmp_path / "bench", "vapor-benchmark faults")
    assert os.listdir(tmp_path / "bench" / "trials") == []


def test_a_folder_that_grows_is_known_again_and_others_are_refused(tmp_path):
    claim_folder(tmp_path / "bench", "vapor-benchmark faults")
    (tmp_path / "bench" / "summary.json").write_text("{}")
    claim_folder(tmp_path / "bench", "vapor-benchmark faults")
    refused(tmp_path / "bench", MANIFEST, "summary.json")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "summary.json").write_text("mine")
    with pytest.raises(SequenceError, match=r"holds summary\.json, expected"):
        claim_folder(tmp_path / "mine", "vapor-benchmark faults")
    claim_folder(tmp_path / "mine", "vapor-benchmark faults", overwrite=True)
    claim_folder(tmp_path / "mine", "vapor-benchmark faults")


def test_a_folder_that_grows_holds_nothing_that_is_read_and_lies_in_none_of_the_users(tmp_path):
    (tmp_path / "data" / "rgb").mkdir(parents=True)
    (tmp_path / "data" / "rgb" / "1.png").write_text("image")
    data, image = tmp_path / "data", tmp_path / "data" / "rgb" / "1.png"
    for place, read in ((data, data), (data, image), (tmp_path, data)):
        with pytest.raises(SequenceError, match=f"{read}: is read, and would be written to"):
            claim_folder(place, "vapor-benchmark regressors", reads=[read], overwrite=True)
    with pytest.raises(SequenceError, match=r"rgb: holds 1\.png and lies in .*data, which is read"):
        claim_folder(data / "rgb", "vapor-benchmark regressors", reads=[data], overwrite=True)
    for _ in range(2):
        claim_folder(data / "out", "vapor-benchmark regressors", reads=[data])
    assert contents(data).keys() == {"rgb/1.png", f"out/{MANIFEST}"}


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
