"""The page of the measurements is made from data, and `make measurements` makes the data."""

import json

import pytest

from docs.measuring import running
from docs.measuring.__main__ import main
from docs.measuring.measurement import Measurements
from docs.measuring.page import page_of
from docs.measuring.tables import table_of
from tests.helpers.checkout import CHECKOUT

MADE_UP = """
introduction = "# Measured"

[[measurement]]
name = "fake"
part = "Made up"
title = "Walks that are made up"
about = "No walks."
minutes = 1
commands = ["echo once >> calls", "test -f ready && cp ready summary.json"]
note = "A note."
[[measurement.table]]
file = "summary.json"
records = "walks"
by = ["scene"]
columns = [
    {name = "right", total = "success"},
    {name = "error", median = "error", unit = "cm"},
    {name = "of each", each = "error", unit = "cm", digits = 0},
    {name = "longest", largest = "error", unit = "m", digits = 2},
]

[[measurement]]
name = "step"
part = "Made up"
title = "A step"
about = "Random weights."
minutes = 2
commands = [
    "vapor-benchmark step --preset tables --engines torch --repetitions 1 --num-samples 10 --summary s.json",
]
[[measurement.table]]
file = "s.json"
records = "rows"
by = ["part"]
columns = [{name = "median", value = "median_ms", unit = "ms"}]
[[measurement.table]]
printed = "network by"
"""

WALKS = [{"scene": "stairs", "success": number > 0, "error": 0.01 * (number + 1)} for number in range(10)]


@pytest.fixture
def made_up(tmp_path):
    """A folder of documentation with two measurements."""
    (tmp_path / "docs" / "measurements").mkdir(parents=True)
    (tmp_path / "docs" / "measurements" / "list.toml").write_text(MADE_UP, encoding="utf-8")
    return Measurements(tmp_path / "docs")


def make(made_up, *arguments):
    return main(arguments, made_up.docs, made_up.docs.parent / "build")


def test_the_page_is_what_its_list_and_results_give():
    measurements = Measurements(CHECKOUT / "docs")
    assert measurements.page.read_text(encoding="utf-8") == page_of(measurements), "run `make measurements ONLY=--page`"


def test_every_result_is_in_the_list_and_small():
    measurements = Measurements(CHECKOUT / "docs")
    files = [*(CHECKOUT / "docs" / "measurements").glob("*.json")]
    assert {file.stem for file in files} <= measurements.entries.keys()
    assert all(file.stat().st_size < 20_000 for file in files)


def test_what_is_interrupted_goes_on_and_what_is_finished_is_not_run_again(made_up, capsys, monkeypatch):
    folder = made_up.docs.parent / "build" / "fake"
    assert make(made_up, "fake") == 1
    assert "fake: status 1 of: test -f ready" in capsys.readouterr().err
    assert made_up.result("fake") is None
    assert "*Not measured yet.*" in made_up.page.read_text(encoding="utf-8")

    (folder / "ready").write_text(json.dumps({"walks": WALKS}))
    for _ in range(2):
        assert make(made_up, "fake") == 0
        assert (folder / "calls").read_text() == "once\n"
    monkeypatch.setattr(running, "code_digest", lambda *names: "other code")
    assert make(made_up, "fake") == 0
    assert (folder / "calls").read_text() == "once\nonce\n"


def test_a_measurement_of_the_library_becomes_a_section_of_the_page(made_up):
    assert made_up.missing == ["fake", "step"]
    assert make(made_up, "step") == 0
    assert made_up.missing == ["fake"]
    result = made_up.result("step")
    assert {"date", "processor", "commit", "version", "seconds", "commands", "tables"} == result.keys()
    rows = dict(result["tables"][0]["rows"])
    (median_ms,) = rows["network by torch, 10 samples"]
    page = made_up.page.read_text(encoding="utf-8")
    assert f"| network by torch, 10 samples | {median_ms:.1f} |" in page
    assert "network by torch, 10 samples" in result["tables"][1]["text"]
    assert f"*Measured on {result['date']}: vapor-track " in page
    assert "*Not measured yet.*" in page  # the other


def test_figures_of_several_runs_have_intervals(made_up):
    folder = made_up.docs.parent / "build" / "fake"
    folder.mkdir(parents=True)
    (folder / "ready").write_text(json.dumps({"walks": WALKS}))
    assert make(made_up, "fake") == 0
    ((name, (right, error, each, longest)),) = made_up.result("fake")["tables"][0]["rows"]
    assert name == "stairs"
    assert (right["value"], right["of"]) == (9, 10)
    assert (right["low"], right["high"]) == pytest.approx((0.596, 0.982), abs=0.001)  # Wilson's, as in tables of it
    assert error["value"] == pytest.approx(0.055)
    assert 0.02 <= error["low"] < 0.05
    assert 0.06 < error["high"] <= 0.09
    assert each == [walk["error"] for walk in WALKS]
    assert longest == 0.1
    page = made_up.page.read_text(encoding="utf-8")
    assert "|  | right | error, cm | of each, cm | longest, m |" in page
    assert "| stairs | 9 of 10 (6–10) | 5.5 (" in page
    assert "| 1, 2, 3, 4, 5, 6, 7, 8, 9, 10 | 0.10 |" in page
    assert "A note." in page


def test_runs_cut_from_one_walk_come_together(tmp_path):
    runs = [{"scene": "stairs", "walk": number // 5, "error": number // 5} for number in range(10)]
    (tmp_path / "s.json").write_text(json.dumps({"runs": runs}))
    spec = {"file": "s.json", "records": "runs", "by": ["scene"], "columns": [{"name": "error", "mean": "error"}]}
    ((_, (alone,)),) = table_of(spec, tmp_path)["rows"]
    ((_, (together,)),) = table_of(spec | {"walk": "walk"}, tmp_path)["rows"]
    assert (together["low"], together["high"]) == (0.0, 1.0)
    assert alone["low"] > 0.0


def test_figures_that_are_not_there_are_no_figures(made_up, capsys):
    folder = made_up.docs.parent / "build" / "fake"
    folder.mkdir(parents=True)
    (folder / "ready").write_text(json.dumps({"walks": [{"scene": "stairs"}]}))
    assert make(made_up, "fake") == 1
    assert "fake: no figures: KeyError('success')" in capsys.readouterr().err
    assert made_up.result("fake") is None


def test_names_are_checked_and_listed(made_up, capsys):
    assert make(made_up, "nothing") == 2
    assert "nothing: no such measurement, expected some of fake, step" in capsys.readouterr().err
    assert make(made_up, "--list") == 0
    out = capsys.readouterr().out
    assert "fake                    1 min  never" in out
    assert "0 hours for the 2 that are not measured yet" in out
    assert not made_up.page.exists()


def test_recordings_of_others_must_be_there(made_up, capsys, monkeypatch):
    text = MADE_UP.replace("echo once >> calls", "ls $RECORDINGS")
    (made_up.docs / "measurements" / "list.toml").write_text(text, encoding="utf-8")
    monkeypatch.setenv("RECORDINGS", str(made_up.docs / "none"))
    assert make(made_up, "fake") == 1
    assert "none: no such folder, expected the recordings (RECORDINGS=FOLDER)" in capsys.readouterr().err
