"""Experiments that vary a setting, alpha or the weight decay."""

import json
import os
from dataclasses import replace

import cv2
import pytest

from filtering.errors import VaporTrackError
from tests.helpers.full import full
from tests.helpers.pages import ReadPage
from tests.helpers.tiny_experiments import TINY_TRAIN
from vapor.checkpoints.calibration import Calibration
from vapor.evaluation.posterior import posterior_metrics
from vapor.experiments import training_runs as runs_module
from vapor.experiments.alpha import AlphaConfig
from vapor.experiments.decay import DecayConfig
from vapor.experiments.scenes import rendered_height
from vapor.experiments.sweep import Sweep, by_value
from vapor.regressors.network_config import NetworkConfig
from vapor.track import main
from vapor.training.presets import PRESETS

pytestmark = pytest.mark.usefixtures("unchecked", "rough_light")

TINY = AlphaConfig(
    alphas=(0.1, 1.0), runs=2, sequences=1, frames=32, test_frames=6, num_samples=50, workers=1, train=TINY_TRAIN
)

WORDS = [
    "dinner-table",
    "--runs",
    "1",
    "--sequences",
    "1",
    "--frames",
    "32",
    "--test-frames",
    "6",
    "--num-samples",
    "50",
    "--workers",
    "1",
    "--train.epochs",
    "1",
    "--train.batch-size",
    "16",
    "--train.network.image-width",
    "32",
    "--train.network.image-height",
    "32",
    "--train.network.shortest-edge",
    "34",
    "--train.network.feature-dim",
    "16",
]


@full
def test_every_alpha_and_run_is_trained_once_and_kept(tmp_path, monkeypatch):
    first = Sweep(["round-table"], tmp_path, TINY)
    assert list(first.render())[-1] == (2, 2)
    results = list(first.train())
    assert sorted((r["alpha"], r["seed"]) for r in results) == [(0.1, 0), (0.1, 1), (1.0, 0), (1.0, 1)]
    assert all(r["images"] == 6 for r in results)
    assert len({r["negative_log_density"] for r in results}) == 4  # no two trainings are one

    monkeypatch.setattr(runs_module, "train_on_images", lambda *_, **__: pytest.fail("trained again"))
    again = Sweep(["round-table"], tmp_path, TINY)
    assert list(again.render()) == [(2, 2)]
    assert list(again.train()) == results


def test_images_are_read_once_for_many_trainings_and_again_when_a_file_changes(tmp_path, monkeypatch):
    read = []
    load = runs_module.load_training_set
    monkeypatch.setattr(runs_module, "load_training_set", lambda s, *a, **k: read.append(list(s)) or load(s, *a, **k))
    monkeypatch.setattr(runs_module, "in_parallel", lambda function, jobs, _: (function(*job) for job in jobs))
    experiment = Sweep(["round-table"], tmp_path, replace(TINY, runs=1))
    list(experiment.render())
    list(experiment.train())
    assert len(read) == 2  # to train on and to test on, for two trainings
    (walk,) = (tmp_path / "images").glob("*-train-*")
    os.utime(walk)
    list(experiment.train())
    assert [len(names) for names in read] == [1, 1, 1]
    assert "train" in read[2][0]


def test_alpha_is_all_that_is_varied_of_the_small_training_for_tables():
    config = AlphaConfig().varied(0.3)
    assert config.loss.alpha == 0.3
    small = replace(PRESETS["tables"], calibrate=False, validation_fraction=0.0)
    assert replace(config, loss=small.loss) == small


@pytest.mark.parametrize(
    "network",
    [NetworkConfig(), PRESETS["tables"].network, PRESETS["resnet18"].network, NetworkConfig(image_width=320)],
)
def test_synthetic_images_are_never_enlarged_for_a_network(network):
    height = rendered_height(network.frame_size)
    assert height > network.frame_size[1]
    assert round(height * 4 / 3) > network.frame_size[0]


def test_cached_samples_are_those_of_the_figures(tmp_path):
    experiment = Sweep(["dinner-table"], tmp_path, AlphaConfig(**{**vars(TINY), "runs": 1, "alphas": (0.5,)}))
    list(experiment.render())
    (result,) = experiment.train()
    truth, samples = experiment.samples("dinner-table", 0.5)
    assert len(samples) == len(truth) == 6
    assert len(samples[0]) == 50
    again = posterior_metrics(samples, truth, Calibration(2.0, 2.0))
    assert again["recall"] == result["recall"]
    assert again["negative_log_density"] == pytest.approx(result["negative_log_density"], rel=1e-3)


def test_figures_are_gathered_by_scene_and_value():
    results = [
        {"scene": "a", "alpha": 1.0, "seed": 0, "recall": {"near": 0.1}},
        {"scene": "a", "alpha": 0.2, "seed": 1, "recall": {"near": 0.3}},
        {"scene": "a", "alpha": 0.2, "seed": 0, "recall": {"near": 0.2}},
    ]
    assert by_value(results, "alpha", lambda r: r["recall"]["near"]) == {"a": {0.2: [0.2, 0.3], 1.0: [0.1]}}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"alphas": ()}, "alphas are"),
        ({"alphas": (0.1, 0.1)}, "alphas are"),
        ({"alphas": (1.5,)}, "alpha"),
        ({"alphas": (0.001,)}, "alpha 0.001 of 100 samples leaves none to learn, expected at least 0.01"),
        ({"runs": 0}, "runs"),
        ({"gamma": 0.0}, "gamma"),
    ],
)
def test_an_experiment_that_cannot_be_is_refused(change, message):
    with pytest.raises(VaporTrackError, match=message):
        AlphaConfig(**change)


def test_the_command_writes_results_and_pictures_and_prints_medians(tmp_path, capfd):
    words = ["experiment", "alpha", *WORDS, "--alphas", "0.2", "1.0"]
    assert main([*words, "--output", str(tmp_path / "out")]) == 0
    printed = capfd.readouterr().out
    assert "dinner-table, 2 modes" in printed
    report = json.loads((tmp_path / "out" / "alpha.json").read_text())
    assert set(report["median_recall"]["0.1m/10deg"]["dinner-table"]) == {"0.2", "1"}
    assert len(report["runs"]) == 2
    page = ReadPage.of((tmp_path / "out" / "report.html").read_text())
    medians = report["median_recall"]["0.1m/10deg"]["dinner-table"]
    assert [page.cells[page.cells.index(alpha) + 1] for alpha in medians] == [f"{v:.2f}" for v in medians.values()]
    assert [tag for tag, _ in page.tags].count("img") == 2
    for name in ("recall.png", "positions-dinner-table.png"):
        picture = cv2.imread(str(tmp_path / "out" / name))
        assert picture is not None
        assert picture.std() > 10


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"decays": (0.0, 0.0)}, r"decays are \(0.0, 0.0\), expected each at most once"),
        ({"decays": (0.0, -1.0)}, "encoder_weight_decay is -1.0, expected a number of at least 0"),
        ({"decays": (float("nan"),)}, "encoder_weight_decay is nan"),
        ({"training_images": 0}, "training_images is 0"),
    ],
)
def test_a_decay_that_cannot_be_is_refused(change, message):
    with pytest.raises(VaporTrackError, match=message):
        DecayConfig(**change)


@full
def test_the_decay_experiment_judges_test_and_training_images_and_goes_on(tmp_path, monkeypatch, capfd):
    words = ["experiment", "decay", *WORDS, "--decays", "0", "1e3", "--training-images", "8", "--output", str(tmp_path)]
    assert main(words) == 0
    printed = capfd.readouterr().out
    assert "dinner-table, 2 modes" in printed
    report = json.loads((tmp_path / "decay.json").read_text())
    free, constrained = report["runs"]
    assert (free["decay"], constrained["decay"]) == (0.0, 1000.0)
    assert free["mean"] != constrained["mean"]
    assert (free["images"], free["training"]["images"]) == (6, 8)
    assert report["medians"]["training"]["modes"]["dinner-table"]["0"] == free["training"]["modes"]
    page = ReadPage.of((tmp_path / "report.html").read_text())
    both = (report["medians"][images]["modes"]["dinner-table"]["1000"] for images in ("test", "training"))
    assert page.cells[page.cells.index("1000") + 1] == ", ".join(f"{value:.2f}" for value in both)
    pictures = [tmp_path / name for name in ("decay.png", "positions-dinner-table.png")]
    for path in pictures:
        picture = cv2.imread(str(path))
        assert picture is not None
        assert picture.std() > 10
        path.unlink()

    monkeypatch.setattr(runs_module, "train_on_images", lambda *_, **__: pytest.fail("trained again"))
    assert main(words) == 0
    assert capfd.readouterr().out == printed
    assert json.loads((tmp_path / "decay.json").read_text()) == report
    assert all(path.exists() for path in pictures)


def test_another_kind_of_experiment_is_refused(capfd):
    with pytest.raises(SystemExit, match="2"):
        main(["experiment", "beta"])
    assert "expected one of alpha, decay, schedule, table first" in capfd.readouterr().err
