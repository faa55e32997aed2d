"""`vapor-track synthesize`, and a run of what it wrote."""

import re

import pytest

from sequences import paths
from sequences.reader import SequenceReader
from sequences.synthesize import synthesize
from tests.helpers.command_line import contents, refuse, skipped_in_run
from vapor.track import main


@pytest.mark.usefixtures("unchecked", "plain_results")
def test_a_synthetic_sequence_appears_and_can_be_run(tiny_model, tmp_path, capsys):
    output = tmp_path / "ceiling.mcap"
    words = ["synthesize", "ceiling", str(output), "--frames", "8", "--width", "80", "--height", "60", "--seed", "5"]
    assert main(words) == 0
    out, err = capsys.readouterr()
    assert f"{output}: 8 images" in out
    assert re.fullmatch(r"(rendering: .*\n)+", err)
    assert {path.name for path in tmp_path.iterdir()} == {"ceiling.mcap"}
    assert skipped_in_run(output, tiny_model, tmp_path / "out") == (8, {})


def test_a_synthetic_sequence_can_have_thirty_images_a_second(tmp_path, capsys):
    output = tmp_path / "ceiling.mcap"
    words = ["--frames", "7", "--rate", "30", "--width", "16", "--height", "16"]
    assert main(["synthesize", "ceiling", str(output), *words]) == 0
    assert "7 images" in capsys.readouterr().out
    times_ns = [frame.time_ns for frame in SequenceReader(output)]
    assert times_ns[6] - times_ns[0] == 200_000_000


def test_a_folder_that_cannot_be_written_to_is_named(tmp_path, capsys):
    (tmp_path / "file").write_text("mine")
    words = ["--frames", "2", "--width", "16", "--height", "16"]
    for folder in ("absent", "file"):
        output = tmp_path / folder / "s.mcap"
        refuse(["synthesize", "round-table", str(output), *words], capsys, output, "expected the folder")
    refuse(["synthesize", "round-table", str(tmp_path), *words], capsys, tmp_path, "cannot write: Is a directory")
    assert contents(tmp_path) == {"file": b"mine"}


def test_a_test_path_is_found_even_where_no_path_can_be_as_wished(monkeypatch):
    tried = []
    monkeypatch.setattr(paths, "resolvable", lambda seen: tried.append(len(seen)))  # never
    sequence = synthesize("ceiling", seed=0, num_frames=20, width=16, height=12)
    assert len(sequence.world_from_camera) == 20
    assert 10 < len(tried) <= 100
