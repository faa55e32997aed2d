"""`vapor-track convert`, and runs of what it wrote."""

import json

import numpy as np
import pytest

from filtering.se3 import Poses
from sequences.frame import Trajectory
from sequences.trajectories.tum import write_tum
from tests.helpers.command_line import refuse, skipped_in_run
from tests.helpers.data_sets import make_7scenes, make_tum, truth_at
from tests.helpers.sequence_files import BEGIN_NS
from vapor.track import main


@pytest.mark.usefixtures("unchecked", "plain_results")
def test_a_converted_tum_folder_with_recorded_odometry_can_be_run(tiny_model, tmp_path, capsys):
    make_tum(tmp_path / "data")
    write_tum(tmp_path / "odometry.tum", truth_at([BEGIN_NS - 5_000_000 + 20_000_000 * i for i in range(20)]))
    output = tmp_path / "sequence.mcap"
    words = ["convert", str(tmp_path / "data"), str(output), "--odometry", str(tmp_path / "odometry.tum")]
    assert main(words) == 0
    assert "10 images; odometry: recorded: odometry.tum" in capsys.readouterr().out
    assert skipped_in_run(output, tiny_model, tmp_path / "out") == (10, {})
    config = json.loads((tmp_path / "out" / "config.json").read_text())
    assert config["sequence"]["odometry"] == "recorded: odometry.tum"


@pytest.mark.usefixtures("unchecked", "plain_results")
def test_a_converted_7_scenes_folder_with_simulated_odometry_can_be_run(tiny_model, tmp_path, capsys):
    make_7scenes(tmp_path / "data")
    output = tmp_path / "sequence.mcap"
    words = ["convert", str(tmp_path / "data" / "seq-01"), str(output), "--odometry-noise", "--frames", "2:9"]
    assert main([*words, "--noise.scale", "0.1"]) == 0
    assert "7 images; odometry: simulated: scale 0.1" in capsys.readouterr().out
    assert skipped_in_run(output, tiny_model, tmp_path / "out") == (7, {})


def test_a_conversion_of_nothing_is_refused(walk_of_25, tmp_path, capsys):
    words = ["convert", str(tmp_path / "data"), str(tmp_path / "o.mcap")]
    refuse(words, capsys, "data: no such folder", "transforms.json")
    make_tum(tmp_path / "data")
    write_tum(tmp_path / "day.tum", Trajectory(np.array([10**9, 2 * 10**9]), Poses.identity(2)))
    refuse([*words, "--odometry", str(tmp_path / "day.tum")], capsys, "day.tum", "covers no image")
    there = "there are 10, numbered 0 to 9\n"
    refuse([*words, "--frames", "50:60"], capsys, "no image with a true pose in frames 50:60", there)
    part = ["convert", f"{tmp_path / 'data'}@0:5", words[2]]
    refuse(part, capsys, "data@0:5: no such folder", "`convert` has --frames")
    refuse(["convert", str(walk_of_25), words[2]], capsys, walk_of_25, "is a file, expected the folder of")
    assert not (tmp_path / "o.mcap").exists()
