"""`vapor-track export`: what it says, what it refuses, and that it replaces nothing but exported models."""

import os
import re
from pathlib import Path

import pytest

from sequences.outputs import results_folder
from tests.helpers.command_line import contents, refuse
from vapor.engines import onnx_export
from vapor.engines.onnx_file import describe_onnx
from vapor.engines.start import start_engine
from vapor.track import main


@pytest.fixture
def folder(tmp_path, tiny_model, monkeypatch) -> Path:
    """The working directory, with a model, and things of the user's."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "m.safetensors").write_bytes(tiny_model.read_bytes())
    (tmp_path / "mine.onnx").write_text("mine")
    return tmp_path


def test_a_model_is_exported_and_replaced_by_another_export(folder, capsys):
    assert main(["export", "m.safetensors", "out.onnx"]) == 0
    said = r"out\.onnx: \d+\.\d MB; by onnxruntime within \S+ m and \S+ rad of torch\n"
    assert re.fullmatch(said, capsys.readouterr().out)
    first = describe_onnx(folder / "out.onnx")
    assert first.network.image_width == 32
    assert main(["export", "m.safetensors", "out.onnx"]) == 0
    assert main(["export", "m.safetensors", "mine.onnx", "--overwrite"]) == 0
    assert describe_onnx(folder / "mine.onnx").box == first.box
    assert sorted(path.name for path in folder.iterdir()) == ["m.safetensors", "mine.onnx", "out.onnx"]


def test_names_of_any_bytes_can_be_written_and_read(folder):
    name = os.fsdecode(b"r\xe4ume.onnx")  # as of Latin-1
    assert main(["export", "m.safetensors", name]) == 0
    assert main(["export", "m.safetensors", name]) == 0
    engine = start_engine(describe_onnx(Path(name)))
    assert engine.noise_dim == 4


def test_what_is_no_exported_model_is_not_replaced(folder, capsys, monkeypatch):
    monkeypatch.setattr(onnx_export, "_write", None)  # nothing is exported
    with results_folder(folder / "results", "run", writes=("net.onnx",)) as new:
        (new / "net.onnx").write_text("a result")
    (folder / "folder.onnx").mkdir()
    (folder / "model.onnx").symlink_to("m.safetensors")
    before = contents(folder)
    refuse(["export", "m.safetensors", "results/net.onnx"], capsys, "results/net.onnx", "--overwrite")
    for more in ([], ["--overwrite"]):
        refuse(["export", "m.safetensors", "folder.onnx", *more], capsys, "folder.onnx: cannot write: Is a directory")
        refuse(["export", "m.safetensors", "model.onnx", *more], capsys, "m.safetensors: is read, and would be written")
        refuse(["export", "m.safetensors", "absent/m.onnx", *more], capsys, "expected the folder absent to exist")
    assert contents(folder) == before


@pytest.mark.parametrize("output", ["out", "out.safetensors", "onnx", "", " "])
def test_an_output_of_another_name_is_refused(output, folder, capsys):
    with pytest.raises(SystemExit) as stopped:
        main(["export", "m.safetensors", output])
    assert stopped.value.code == 2
    assert re.fullmatch(
        r"vapor-track export: .*expected a (name that ends in \.onnx|path).*\n", capsys.readouterr().err
    )
    assert {path.name for path in folder.iterdir()} == {"m.safetensors", "mine.onnx"}


def test_a_model_that_is_exported_already_damaged_or_absent_is_refused(folder, capsys):
    refuse(["export", "mine.onnx", "out.onnx"], capsys, "mine.onnx: is an exported model, expected one that is not")
    refuse(["export", "gone.onnx", "out.onnx"], capsys, "gone.onnx: no such model file")
    (folder / "bad.safetensors").write_bytes((folder / "m.safetensors").read_bytes()[:-100])
    refuse(["export", "bad.safetensors", "out.onnx"], capsys, "bad.safetensors: cannot be read")
    assert not (folder / "out.onnx").exists()


def test_an_export_that_fails_leaves_the_one_before(folder, capsys, monkeypatch):
    assert main(["export", "m.safetensors", "out.onnx"]) == 0
    before = contents(folder)
    monkeypatch.setattr(onnx_export, "WITHIN_M", -1.0)
    refuse(["export", "m.safetensors", "out.onnx"], capsys, "out.onnx: onnxruntime gives poses up to", "not written")
    monkeypatch.setattr(onnx_export, "find_spec", lambda name: None)
    refuse(["export", "m.safetensors", "out.onnx"], capsys, "pip install 'vapor-track[export]'")
    assert contents(folder) == before
