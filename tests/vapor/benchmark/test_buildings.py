"""`vapor-benchmark buildings`: on walks of a few images, with a training of one epoch."""

import json
from dataclasses import replace

import pytest

from sequences.reader import SequenceReader
from tests.helpers.measured import tables_on_the_page
from vapor.benchmark.__main__ import main
from vapor.benchmark.buildings.building import Building, BuildingsConfig
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


@pytest.mark.usefixtures("unchecked")
def test_a_building_is_rendered_trained_and_localized_once(tmp_path, capsys, monkeypatch):
    (walk,) = run(tmp_path)
    out = capsys.readouterr().out
    assert "2: 88 m" in out
    assert (walk["building"], walk["walk"], walk["images"]) == (2, 0, 6)
    assert walk["methods"].keys() == {"single_image", "kalman", "filter", "smoothed"}
    assert sum(walk["status"].values()) == pytest.approx(1.0)
    assert walk["landmarks"] is None
    assert walk["verified"] is None
    assert walk["train_s"] > 0 < walk["run_s"]
    assert (walk["first_right_s"] is None) == (walk["methods"]["filter"]["right"] == 0.0)

    for name in ("buildings.building.train", "buildings.building.run", "rendered.synthesize"):
        monkeypatch.setattr(f"vapor.benchmark.{name}", None)  # all is there
    assert run(tmp_path) == [walk]


@pytest.mark.usefixtures("unchecked")
def test_several_cameras_are_compared_with_one_and_a_unit_with_none(tmp_path):
    walks = run(tmp_path, "--cameras", "2", "--imu")
    assert [walk["reads"] for walk in walks] == [
        "one camera, no imu", "one camera, imu", "2 cameras, no imu", "2 cameras, imu",
    ]  # fmt: skip
    assert [walk["images"] for walk in walks] == [6, 6, 12, 12]
    for name in ("buildings", "cameras", "gravity"):
        for table in tables_on_the_page(name, tmp_path / "summary.json"):
            assert table["rows"]
    images = {file.name.split("-")[2]: SequenceReader(file) for file in (tmp_path / "images").iterdir()}
    assert images["test"].num_images == 12


def test_numbers_of_buildings_are_checked(tmp_path, capsys):
    for numbers, expected in ((["2", "2"], "expected each at most once"), ([], "buildings are none")):
        with pytest.raises(SystemExit):
            main(["buildings", "--buildings", *numbers, "--output", str(tmp_path)])
        assert expected in capsys.readouterr().err
