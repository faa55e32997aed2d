"""A model that a run refuses, and outputs that it cannot write to."""

from tests.helpers.command_line import contents, refuse, refuse_run, words_of_run
from tests.helpers.tiny_model import altered


def test_a_model_of_another_version_is_refused(walk_of_25, tiny_model, earlier, capsys):
    model = altered(tiny_model, earlier.parent / "other.safetensors", lambda t, m: m.update(version="1"))
    refuse_run(walk_of_25, model, earlier, capsys, model, "format version is '1', expected '11'; train the model again")


def test_an_output_that_is_or_lies_in_a_file_is_refused(walk_of_25, tiny_model, tmp_path, capsys):
    (tmp_path / "file").write_text("mine")
    words = words_of_run(walk_of_25, tiny_model, tmp_path / "file")
    refuse(words, capsys, tmp_path / "file", "is a file, expected a directory")
    words = words_of_run(walk_of_25, tiny_model, tmp_path / "file" / "out")
    refuse(words, capsys, tmp_path / "file" / "out", "cannot write", "expected a directory")
    assert contents(tmp_path) == {"file": b"mine"}
