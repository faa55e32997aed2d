"""The schedule experiment: what it counts, when it ends, and what it keeps."""

import contextlib
import json
from dataclasses import replace
from pathlib import Path

import cv2
import pytest

from filtering.errors import VaporTrackError
from tests.helpers.pages import ReadPage
from vapor.evaluation.validation import Validation
from vapor.experiments import schedule as schedule_module
from vapor.experiments.schedule import DEFAULT, PAPER, Clock, Point, ScheduleConfig, summary
from vapor.regressors.loss import LossConfig
from vapor.regressors.network_config import NetworkConfig
from vapor.track import main
from vapor.training.config import TrainConfig
from vapor.training.presets import PRESETS
from vapor.training.progress import Progress

pytestmark = pytest.mark.usefixtures("unchecked")

TINY = ScheduleConfig(
    sequences=1,
    frames=32,
    validation_frames=6,
    train=TrainConfig(
        network=NetworkConfig(image_width=32, image_height=32, shortest_edge=34, feature_dim=16, latent_dim=4),
        loss=LossConfig(alpha=0.3),
        bandwidth_translation_m=2.0,
        bandwidth_rotation_rad=2.0,
        epochs=2,
        batch_size=16,
        calibrate=False,
    ),
)


@pytest.mark.parametrize(
    "shared",
    [
        {"pretrained": False},
        {"pretrained_weights": Path("w.safetensors")},
        {"initial_model": Path("m")},
        {"initial_log_variance": -3.0},
    ],
)
def test_both_start_from_the_same_weights(shared):
    config = replace(TINY, train=replace(TINY.train, **shared))
    (name, value), *_ = shared.items()
    assert getattr(config.of(PAPER), name) == getattr(config.of(DEFAULT), name) == value


@pytest.mark.parametrize("unit", ["box", "metre"])
def test_both_have_the_same_unit_of_positions(unit):
    config = replace(TINY, train=replace(TINY.train, loss=LossConfig(position_unit=unit)))
    assert config.of(PAPER).loss.position_unit == config.of(DEFAULT).loss.position_unit == unit


def test_the_paper_trains_the_same_network_by_its_own_schedule():
    default, paper = TINY.of(DEFAULT), TINY.of(PAPER)
    assert paper.network == default.network
    assert paper.loss.alpha == default.loss.alpha == 0.3
    assert paper.loss.num_samples == 1000
    preset = PRESETS["paper-synthetic"]
    assert paper.validation_images == default.validation_images == TINY.validation_frames
    names = ("learning_rate", "schedule", "decay_factor", "decay_epochs", "batch_size", "epochs", "ema_decay")
    assert all(getattr(paper, name) == getattr(preset, name) for name in names)
    assert (paper.learning_rate, paper.schedule, paper.batch_size) == (1e-4, "steps", 4)


@pytest.mark.parametrize(
    ("enough", "most_s", "epochs"), [(0.3, None, 3), (None, 2.5, 3), (0.9, 1e9, 5), (None, None, 5)]
)
def test_a_training_ends_where_it_is_good_enough_or_took_too_long(enough, most_s, epochs):
    clock = Clock(10, enough, most_s, lambda *_: None)
    with pytest.raises(schedule_module.EnoughError) if epochs < 5 else contextlib.nullcontext():
        for step in range(10):
            epoch = step // 2  # two steps of half a second each
            last = Validation(epoch, 0.0, 0.1 * epoch, 0.0, 0.0) if epoch else None
            clock.follow(Progress("training", step + 1, 10, epoch + 1, 5, seconds=0.5 * (step + 1), validation=last))
        clock.evaluated(0.5)
    expected = [(20 * n, 1.0 * n) for n in range(1, 6)]
    assert [(point.images, point.seconds) for point in clock.course] == expected[:epochs]
    assert [point.recall for point in clock.course] == pytest.approx([0.1 * n for n in range(1, epochs + 1)])


def test_summary_tells_when_each_is_as_good_as_the_default_at_its_best():
    courses = {
        DEFAULT: [Point(100, 10.0, 0.2), Point(200, 20.0, 0.4), Point(300, 30.0, 0.3)],
        PAPER: [Point(100, 15.0, 0.1), Point(800, 120.0, 0.45)],
    }
    figures = summary(courses)
    assert figures["recall"] == 0.4
    assert figures[DEFAULT] == {"images": 200, "seconds": 20.0, "recall": 0.4, "reached": True}
    assert figures[PAPER] == {"images": 800, "seconds": 120.0, "recall": 0.45, "reached": True}
    assert (figures["times_images"], figures["times_seconds"]) == (4.0, 6.0)
    assert not summary({**courses, PAPER: courses[PAPER][:1]})[PAPER]["reached"]


@pytest.mark.usefixtures("rough_light")
def test_both_are_trained_once_and_told_side_by_side(tmp_path, capsys, monkeypatch):
    network = ("--train.network.image-width", "32", "--train.network.image-height", "32")
    network += ("--train.network.shortest-edge", "34", "--train.network.feature-dim", "16")
    words = ["experiment", "schedule", "--scene", "round-table", "--output", str(tmp_path), "--most", "0.001"]
    words += ["--sequences", "4", "--frames", "32", "--validation-frames", "20", "--workers", "1"]
    words += ["--train.epochs", "2", *network]
    assert main(words) == 0
    report = json.loads((tmp_path / "schedule.json").read_text())
    assert [point["images"] for point in report["courses"]["default"]] == [128, 256]
    assert [point["images"] for point in report["courses"]["paper"]] == [128]  # given up after its first epoch
    assert cv2.imread(str(tmp_path / "schedule.png")).shape[1] > 800
    assert "times the time" in capsys.readouterr().out
    page = ReadPage.of((tmp_path / "report.html").read_text())
    assert "times the time" in page.words
    assert page.cells[page.cells.index("paper") + 1] == str(report["paper"]["images"])
    monkeypatch.setattr(schedule_module, "train", lambda *_, **__: pytest.fail("trained again"))
    assert main(words) == 0
    assert json.loads((tmp_path / "schedule.json").read_text()) == report
    with pytest.raises(pytest.fail.Exception, match="trained again"):  # other images are judged: nothing is done yet
        main([*words, "--validation-frames", "21"])


def test_settings_that_cannot_be_are_refused():
    with pytest.raises(VaporTrackError, match="sequences"):
        ScheduleConfig(sequences=0)
