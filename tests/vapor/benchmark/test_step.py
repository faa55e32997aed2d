"""`vapor-benchmark step`: the network and the filter are timed, each without the other, and a whole step."""

import json

from tests.helpers.command_line import refuse
from tests.helpers.measured import tables_on_the_page
from vapor.benchmark.__main__ import main

QUICK = ["step", "--repetitions", "1", "--num-samples", "10"]


def test_the_network_of_a_preset_is_timed_without_a_model_and_without_the_filter(capsys):
    assert main([*QUICK, "--preset", "tables", "--engines", "torch", "openvino"]) == 0
    out = capsys.readouterr().out
    assert "network by torch, 10 samples" in out
    assert "network by openvino, 10 samples" in out
    assert "filter" not in out
    assert "whole step" not in out


def test_the_filter_is_timed_as_it_ships_and_with_beliefs_that_have_as_many_hypotheses_as_asked_for(tiny_model, capsys):
    assert main([*QUICK, "--model", str(tiny_model), "--hypotheses", "7", "20"]) == 0
    out = capsys.readouterr().out
    assert "filter as it ships, 10 samples, " in out
    assert "filter, none merged, 7 hypotheses" in out
    assert "filter, none merged, 20 hypotheses" in out


def test_whole_steps_are_timed_on_the_images_of_a_recording(tiny_model, walk_of_25, capsys):
    words = ["--model", str(tiny_model), "--hypotheses", "7", "--sequence", str(walk_of_25), "--engines", "torch"]
    assert main([*QUICK, *words]) == 0
    assert "whole step by torch, image bytes to estimate" in capsys.readouterr().out


def test_the_rows_of_the_table_are_written_as_json_where_nothing_else_is(tmp_path, capsys):
    file = tmp_path / "new" / "step.json"
    words = [*QUICK, "--preset", "tables", "--engines", "torch", "--summary", str(file)]
    for _ in range(2):  # the second time it is replaced
        assert main(words) == 0
        decoding, network = json.loads(file.read_text())["rows"]
        assert network["part"] == "network by torch, 10 samples"
        (table,) = tables_on_the_page("step", file)
        assert [name for name, _ in table["rows"]] == [decoding["part"], network["part"]]
        assert 0.0 < decoding["median_ms"] <= decoding["p99_ms"]
    file.write_text("mine")
    refuse(["vapor-benchmark", *words], capsys, "step.json: exists and is no summary of a benchmark")
    assert file.read_text() == "mine"


def test_a_recording_that_is_not_there_is_refused(capsys):
    refuse(["vapor-benchmark", *QUICK, "--sequence", "a.mcap"], capsys, "a.mcap")
