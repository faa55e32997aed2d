"""The results of a run, read again from their directory."""

import re
import sys
from dataclasses import replace

import numpy as np
import pandas
import pytest

from filtering.errors import VaporTrackError
from sequences.errors import SequenceError
from sequences.outputs import results_folder
from tests.helpers.checkout import CHECKOUT
from tests.helpers.simulated_run import simulated_record
from vapor.evaluation.trajectory import pose_errors
from vapor.pipeline.results import RESULTS, write_results
from vapor.reporting.stored_run import read_run


def stored(record, directory):
    with results_folder(directory, "run", writes=RESULTS) as folder:
        write_results(record, folder, {}, title="simulated")
    return directory


@pytest.fixture(scope="module")
def record():
    return simulated_record(60)


@pytest.fixture(scope="module")
def directory(record, tmp_path_factory):
    return stored(record, tmp_path_factory.mktemp("runs") / "run")


def test_trajectories_and_status_are_those_of_the_record(record, directory):
    run = read_run(str(directory))
    assert run.trajectories.keys() == {*record.methods, "truth"}
    for name, trajectory in record.methods.items():
        np.testing.assert_array_equal(run.trajectories[name].times_ns, record.times_ns)
        metres, radians = run.trajectories[name].poses.distance(trajectory.poses)
        assert max(metres.max(), radians.max()) < 1e-8
    assert run.status["status"].tolist() == [*record.status]
    np.testing.assert_array_equal(run.status["time_ns"], record.times_ns)
    np.testing.assert_allclose(run.status["unassigned"], record.unassigned, atol=5e-5)
    np.testing.assert_allclose(run.status["innovation"], record.innovation, atol=5e-4)  # NaN where there is none
    assert run.report["frames"] == len(record.times_ns)


def test_a_table_has_a_row_for_each_image_with_poses_and_errors(record, directory):
    table = read_run(directory).table()
    assert table.index.name == "time_ns"
    np.testing.assert_array_equal(table.index, record.times_ns)
    np.testing.assert_allclose(table["time_s"], np.arange(60) * 0.1)
    poses = record.methods["filter"].poses
    np.testing.assert_allclose(table[["filter.tx", "filter.ty", "filter.tz"]], poses.translation, atol=1e-9)
    _, metres, degrees = pose_errors(record.methods["filter"], record.truth)
    np.testing.assert_allclose(table["filter.error_m"], metres, atol=1e-7)
    np.testing.assert_allclose(table["filter.error_deg"], degrees, atol=1e-4)
    assert "truth.error_m" not in table
    converged = table[table.status == "converged"]
    assert 0 < len(converged) < 60
    assert isinstance(table.groupby("status")["filter.error_m"].median(), pandas.Series)


def test_images_without_a_true_pose_have_no_error(tmp_path):
    record = simulated_record(12, with_truth=False)
    run = read_run(stored(record, tmp_path / "run"))
    assert "truth" not in run.trajectories
    assert not [column for column in run.table() if column.endswith("error_m")]


def test_the_lines_of_the_start_page_run(record, tmp_path, monkeypatch):
    page = (CHECKOUT / "docs" / "start.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL)
    stored(record, tmp_path / "demo" / "staircase")
    monkeypatch.chdir(tmp_path)
    exec(compile(block, "start.md", "exec"), {"__name__": "page"})
    assert (tmp_path / "paths.png").read_bytes().startswith(b"\x89PNG")


def test_a_folder_that_is_no_run_is_named(tmp_path):
    with pytest.raises(SequenceError, match=r"elsewhere: no status\.csv and report\.json, expected the results of"):
        read_run(tmp_path / "elsewhere")


def test_that_it_may_be_another_place_is_the_first_notice(tmp_path):
    record = simulated_record(20)
    nowhere = replace(record, status=("ambiguous",) * 20)
    with results_folder(tmp_path / "run", "run", writes=RESULTS) as folder:
        result = write_results(nowhere, folder, {}, title="simulated", notices=["mind the step"])
    assert result.notices[0].startswith("hardly any image says which place it is (0% are converged)")
    assert result.notices[1] == "mind the step"
    assert result.report["notices"] == [*result.notices]


def test_a_file_that_was_changed_is_named(record, tmp_path):
    directory = stored(record, tmp_path / "run")
    (directory / "status.csv").write_text("time\n")
    with pytest.raises(SequenceError, match=r"status\.csv: differs from what manifest\.json lists"):
        read_run(directory)


BAD = {
    "begins with 'time', expected the columns time,status,": lambda text: "time\n",
    r"status\.csv:3: 2 columns, expected the 12": lambda text: "\n".join([*text.split("\n")[:2], "1.0,lost"]),
    r"status\.csv:2: status: 'sure', expected one of converged, ambiguous, lost": lambda text: text.replace(
        ",lost,", ",sure,", 1
    ),
    r"status\.csv:2: std_m is 'wide', expected a number": lambda text: text.replace(
        text.split("\n")[1].split(",")[2], "wide", 1
    ),
}


@pytest.mark.parametrize("message", BAD)
def test_what_is_wrong_with_a_status_file_is_said(message, record, tmp_path):
    directory = stored(record, tmp_path / "run")
    (directory / "manifest.json").unlink()
    file = directory / "status.csv"
    file.write_text(BAD[message](file.read_text()))
    with pytest.raises(SequenceError, match=message):
        read_run(directory)


def test_without_pandas_all_but_the_table_is_there(directory, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    run = read_run(directory)
    assert len(run.trajectories["filter"]) == 60
    with pytest.raises(
        VaporTrackError, match=r"pandas is not installed, expected it for tables: pip install 'vapor-track\[pandas"
    ):
        run.table()
