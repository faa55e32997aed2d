"""A run over a recording of several cameras."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from filtering.measurement_noise import MeasurementNoise
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from sequences.options import SequenceOptions
from sequences.reader import SequenceReader
from sequences.trajectories.tum import read_tum
from tests.helpers.rigs import FRONT, LEFT, RIGHT, Rig, pose_shown
from tests.helpers.sequence_files import Walk
from vapor.pipeline.config import FilteringConfig, RunConfig
from vapor.pipeline.localize import localize
from vapor.pipeline.results import write_results
from vapor.pipeline.run import run

NOISE = MeasurementNoise(length_m=0.03, length_rad=0.03)  # so that twelve images are twelve views


class Seeing:
    """Knows the pose of each camera by the image's colour and width; the left one may be turned on its mount."""

    def __init__(self, turned_rad: float = 0.0) -> None:
        self.turned = Poses.exp(np.array([0.0, 0.0, 0.0, 0.0, turned_rad, 0.0]))

    def observe(self, image: np.ndarray, *, rng: np.random.Generator) -> PosePosterior:
        truth = pose_shown(image, self.turned)
        samples = Poses.stack([truth] * 100) @ Poses.exp(rng.normal(0.0, 0.005, (100, 6)))
        return PosePosterior.from_samples(samples, NOISE)


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return Rig({"left": 0, "right": 0}, {}).write(tmp_path_factory.mktemp("rig") / "rig.mcap", Walk(12))


def test_every_image_of_every_camera_gives_the_pose_of_the_first(rig: Path, tmp_path: Path) -> None:
    reading = SequenceOptions(image_topic=f"{FRONT},{LEFT}")
    record = localize(SequenceReader(rig, reading), Seeing(), tmp_path, FilteringConfig(recording=False), NOISE)
    assert record.cameras == (FRONT, LEFT) * 12
    assert record.truth is not None
    for name in ("filter", "smoothed", "single_image", "kalman"):
        found = record.methods[name].poses
        errors_m = found[: len(record.truth)].distance(record.truth.poses)[0]
        assert errors_m.max() < 0.05, name
    assert not record.left_out.any()


def test_a_camera_whose_mount_is_wrong_is_told(rig: Path, tmp_path: Path) -> None:
    reader = SequenceReader(rig)
    record = localize(reader, Seeing(2.0), tmp_path, FilteringConfig(recording=False), NOISE)
    assert record.truth is not None
    errors_m = record.methods["filter"].poses[-6:].distance(record.truth.poses[-6:])[0]
    assert errors_m.max() < 0.1
    result = write_results(record, tmp_path, {}, title="rig")
    left_out = result.report["cameras"][LEFT]["left_out"]
    assert left_out >= 3
    (notice,) = [each for each in result.notices if LEFT in each]
    assert notice.startswith(f"{LEFT}: {left_out} of its 12 images were left out, as they fit nowhere")
    assert f"{left_out} left out" in (tmp_path / "report.html").read_text()
    with open(tmp_path / "status.csv") as file:
        rows = list(csv.DictReader(file))
    assert [row["camera"] for row in rows] == list(record.cameras)


def test_a_run_writes_a_pose_for_each_image_and_says_of_which_cameras(
    rig: Path, tiny_model: Path, tmp_path: Path
) -> None:
    result = run(rig, str(tiny_model), tmp_path / "result", RunConfig())
    assert {name: each["images"] for name, each in result.report["cameras"].items()} == {
        FRONT: 12,
        LEFT: 12,
        RIGHT: 12,
    }
    trajectory = read_tum(tmp_path / "result" / "trajectory.tum")
    assert len(trajectory) == 36
    config = json.loads((tmp_path / "result" / "config.json").read_text())
    assert config["reading"]["image_topic"] == f"{FRONT},{LEFT},{RIGHT}"


def test_one_camera_is_enough_where_it_is_named(rig: Path, tiny_model: Path, tmp_path: Path) -> None:
    reading = SequenceOptions(image_topic=FRONT)
    result = run(rig, str(tiny_model), tmp_path / "result", RunConfig(recording=False), reading=reading)
    assert "cameras" not in result.report
    assert result.report["frames"] == 12
