"""`vapor-benchmark buildings`: on walks of a few images, with a training of one epoch."""

import json
from dataclasses import replace

import pytest

from sequences.options import SequenceOptions
from tests.helpers.measured import tables_on_the_page
from vapor.benchmark.__main__ import main
from vapor.benchmark.buildings.building import SHOWN, Building, BuildingsConfig
from vapor.benchmark.commands.buildings import tables
from vapor.pipeline.config import RunConfig

OPTIONS = [
    "--training-walks", "2", "--test-walks", "1", "--frames", "12", "20", "--test-frames", "6", "--height", "36",
    "--train.epochs", "1", "--train.no-landmarks", "--train.network.image-width", "44",
    "--train.network.image-height", "33", "--train.network.shortest-edge", "34", "--num-samples", "30",
]  # fmt: skip


def run(output, *more):
    assert main(["buildings", "--buildings", "2", "--output", str(output), *OPTIONS, *more]) == 0
    return json.loads((output / "summary.json").read_text())["walks"]


def test_images_follow_the_length_of_the_tour():
    small, large = (Building(number, BuildingsConfig()) for number in (2, 3))
    assert small.tour_m == pytest.approx(87.7, abs=0.05)
    assert [walk.frames for walk in small.training_walks] == [600] * 5
    assert small.training_walks[0].rate_hz == pytest.approx(600 / (2 * small.tour_m))
    assert (small.test_walks[0].frames, small.test_walks[0].rate_hz) == (400, small.training_walks[0].rate_hz)
    assert large.training_walks[0].frames == 1200
    assert large.test_walks[0].rate_hz == 2.5  # 0.7 images a second are slow
    moving = replace(BuildingsConfig(), run=RunConfig(odometry="visual"))
    assert [(walk.frames, walk.rate_hz) for walk in Building(3, moving).test_walks] == [(1600, 10.0)] * 2


def test_several_cameras_are_compared_with_one_and_a_unit_with_none():
    assert Building(2, BuildingsConfig()).ways_to_read == {"": SequenceOptions()}
    ways = Building(2, BuildingsConfig(cameras=3, imu=True)).ways_to_read
    assert [*ways] == ["one camera, no imu", "one camera, imu", "3 cameras, no imu", "3 cameras, imu"]
    assert ways["3 cameras, imu"] == SequenceOptions()
    assert ways["one camera, no imu"] == SequenceOptions(image_topic="/camera/image/compressed", imu_topic="")


@pytest.mark.usefixtures("unchecked")
def test_a_building_is_rendered_trained_and_localized_once(tmp_path, capsys, monkeypatch):
    walks = run(tmp_path, "--cameras", "2")
    assert "2: 88 m, one camera" in capsys.readouterr().out
    assert [(walk["reads"], walk["images"]) for walk in walks] == [("one camera", 6), ("2 cameras", 12)]
    for walk in walks:
        assert (walk["building"], walk["walk"]) == (2, 0)
        assert walk["methods"].keys() == {"single_image", "kalman", "filter", "smoothed"}
        assert sum(walk["status"].values()) == pytest.approx(1.0)
        assert walk["landmarks"] is None
        assert walk["verified"] is None
        assert walk["train_s"] > 0 < walk["run_s"]
        assert (walk["first_right_s"] is None) == (walk["methods"]["filter"]["right"] == 0.0)
    for name in ("buildings", "cameras", "gravity"):
        for table in tables_on_the_page(name, tmp_path / "summary.json"):
            assert table["rows"]

    for name in ("buildings.building.train", "buildings.building.run", "rendered.synthesize"):
        monkeypatch.setattr(f"vapor.benchmark.{name}", None)  # all is there
    assert run(tmp_path, "--cameras", "2") == walks


def test_a_cell_has_a_figure_of_each_walk_and_intervals_are_over_buildings():
    def walk(building, share, wrong):
        method = {"right": share, "median_m": share / 10}
        regions = {"50%": 0.5, "90%": 0.9, "95%": 0.95}
        return {
            "building": building, "tour_m": 88.4, "reads": "", "images": 10, "verified": None, "first_right_s": 1.6,
            "methods": dict.fromkeys(SHOWN, method) | {"smoothed": {"right": 1.0, "median_m": 0.005}},
            "status": {"converged": 0.5, "lost": 0.25}, "wrong": wrong, "coverage": regions,
            "train_s": 720.0, "run_s": 30.0,
        }  # fmt: skip

    right, confidence, every = tables([walk(1, 0.2, 0.1), walk(1, 0.4, None), walk(2, 0.9, 0.2), walk(2, 0.9, 0.2)])
    cells = [[*column.cells] for column in right.columns]
    assert [column.header for column in right.columns][-3:] == ["from\ns", "filter\ncm", "smoothed\ncm"]
    assert cells[0] == ["1: 88 m", "2: 88 m"]
    assert [column[0] for column in cells[1:]] == ["–, –", *["20, 40"] * 3, "100, 100", "2, 2", "2.0, 4.0", "0.5, 0.5"]
    (converged, wrong, lost, regions, minutes) = (next(iter(column.cells)) for column in confidence.columns[1:])
    assert (converged, wrong, lost, minutes) == ("50, 50", "10, –", "25, 25", "12 + 0.5")
    assert regions == "50, 90, 95 / 50, 90, 95"
    filtered = {column.header: next(iter(column.cells)) for column in every.columns}
    assert filtered["filter\nright"] == "60 %\n30–90"  # two buildings
    assert filtered["of these\nwrong"].startswith("17 %")


def test_numbers_of_buildings_are_checked(tmp_path, capsys):
    for numbers, expected in ((["2", "2"], "expected each at most once"), ([], "buildings are none")):
        with pytest.raises(SystemExit):
            main(["buildings", "--buildings", *numbers, "--output", str(tmp_path)])
        assert expected in capsys.readouterr().err
