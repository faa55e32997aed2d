"""`vapor-track evaluate` of nothing."""

import pytest

from tests.helpers.command_line import refuse


@pytest.mark.parametrize("words", [["nowhere"], ["empty"], ["run", "--ground-truth", "nowhere.tum"], ["run"]])
def test_an_evaluation_of_nothing_is_refused(words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "trajectory.tum").write_text("1.0 0 0 0 0 0 0 1\n")
    (tmp_path / "run" / "ground_truth.tum").write_text("1.0 0 0 nan 0 0 0 1\n")
    refuse(["evaluate", *words], capsys, "expected")
