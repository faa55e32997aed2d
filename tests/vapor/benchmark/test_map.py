"""`vapor-benchmark map`."""

import json
import re

import numpy as np
import pytest

from filtering.se3 import Poses
from tests.helpers.command_line import main
from tests.helpers.mapped_walks import straight
from tests.helpers.measured import tables_on_the_page
from tests.helpers.room_walks import write_recording
from tests.helpers.textured_room import walk
from vapor.benchmark.commands.map import Errors


def test_errors_are_those_after_the_similarity_that_fits_best():
    true = straight(40)
    elsewhere = Poses.exp(np.array([1.0, -2.0, 3.0, 0.5, 1.0, -0.3])) @ true
    found = Poses(elsewhere.rotation, 4.0 * elsewhere.translation)
    errors = Errors.of(found, true)
    assert errors.scale == pytest.approx(0.25)
    np.testing.assert_allclose(errors.metres, 0.0, atol=1e-9)
    np.testing.assert_allclose(errors.degrees, 0.0, atol=1e-5)
    moved = found.translation.copy()
    moved[20] += 4.0
    assert np.argmax(Errors.of(Poses(found.rotation, moved), true).metres) == 20


def test_a_recording_is_mapped_without_its_true_poses_and_compared_with_them(tmp_path, capsys):
    path = write_recording(tmp_path / "robot.mcap", walk(10, 1), true_poses=True)
    summary = tmp_path / "map.json"
    words = ["map", str(path), "--output", str(tmp_path / "place"), "--summary", str(summary)]
    assert main(["vapor-benchmark", *words]) == 0
    out = capsys.readouterr().out
    assert re.search(r"robot +│ 10 of 10 │ +[01]\.\d cm", out)
    (row,) = json.loads(summary.read_text())["rows"]
    assert (row["walk"], row["placed"], row["images"]) == ("robot", 10, 10)
    assert 0.0 < row["median_m"] <= row["p95_m"] <= row["largest_m"] < 0.1
    (table,) = tables_on_the_page("map", summary)
    assert [name for name, _ in table["rows"]] == ["robot"]
    assert re.search(r"unit: recorded odometry of robot; (0\.99|1\.00)\d\d m", out)
