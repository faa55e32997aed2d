import json
import os
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import pytest

from filtering.errors import VaporTrackError
from tests.data_sets import make_7scenes
from tests.sequence_files import Walk
from vapor.checkpoints.calibration import Calibration
from vapor.commands import experiment as experiment_command
from vapor.evaluation.posterior import posterior_metrics
from vapor.experiments import training_runs as runs_module
from vapor.experiments.alpha import AlphaConfig
from vapor.experiments.decay import DecayConfig
from vapor.experiments.scenes import Scene, rendered_height
from vapor.experiments.sweep import Sweep, by_value
from vapor.experiments.table import TableConfig, TableExperiment, markdown, parse_scene
from vapor.experiments.training_runs import TrainingRun
from vapor.regressors.network_config import NetworkConfig
from vapor.track import main
from vapor.training.config import TrainConfig
from vapor.training.presets import PRESETS

pytestmark = pytest.mark.usefixtures("unchecked")

TINY_TRAIN = TrainConfig(
    network=NetworkConfig(image_width=32, image_height=32, shortest_edge=34, feature_dim=16, latent_dim=4),
    bandwidth_translation_m=2.0,
    bandwidth_rotation_rad=2.0,  # so wide that the density at the truth is more than its floor
    epochs=1,
    batch_size=16,
    calibrate=False,
    validation_fraction=0.0,
)
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


# --- methods side by side --------------------------------------------------------------------------

TINY_TABLE = TableConfig(
    ("variational", "posenet"),
    1,
    sequences=1,
    frames=40,
    test_sequences=1,
    test_frames=12,
    num_samples=50,
    localize=True,
    workers=1,
    train=TINY_TRAIN,
)


@pytest.mark.usefixtures("rough_light")
def test_methods_are_trained_and_drive_the_filter(tmp_path):
    experiment = TableExperiment([parse_scene("staircase")], tmp_path, TINY_TABLE)
    assert list(experiment.render())[-1] == (2, 2)
    results = list(experiment.train())
    assert {r["label"] for r in results} == {"variational", "posenet"}
    for result in results:
        assert result["filter"][0]["frames"] == 12
        assert result["images_seen"] == 40
    text = markdown(results, 0.1)
    assert "| variational |" in text
    assert "0 of 1" in text
    rows = [line.count("|") for line in text.splitlines() if line.startswith("|")]
    assert len(rows) == 4
    assert len(set(rows)) == 1


def test_the_table_gives_medians_and_the_range_of_the_seeds():
    result = {
        "scene": "hall",
        "label": "posenet",
        "images": 10,
        "mode_recall": dict.fromkeys(("0.1m/10deg", "0.2m/15deg", "0.3m/20deg"), 0.5),
        "oracle_recall": dict.fromkeys(("0.1m/10deg", "0.2m/15deg", "0.3m/20deg"), 1.0),
        "mean": {"translation_m": 0.25, "rotation_deg": 3.0},
        "mode": {"translation_m": 0.15, "rotation_deg": 2.0},
        "negative_log_density": 1.5,
        "exact_negative_log_density": None,
        "modes": 2.0,
        "seconds": 90.0,
    }
    recalls = (0.1, 0.4, 0.2)
    results = [
        result | {"seed": k, "recall": {"0.1m/10deg": r, "0.2m/15deg": r, "0.3m/20deg": r}}
        for k, r in enumerate(recalls)
    ]
    results.append({"scene": "hall", "label": "mapnet", "seed": 0, "error": "loss is nan"})
    title, *_, row, empty, failed = markdown(results, 0.1).splitlines()
    assert title == "**hall**, 10 test images, 3 seeds, γ = 0.1"
    assert (empty, failed) == ("", "hall, mapnet, seed 0: loss is nan")
    assert row.startswith(
        "| posenet | 20 % (10-40) | 20 % (10-40) | 20 % (10-40) | 50 % | 100 % | 0.25 m, 3.0° | 0.15 m, 2.0° | 1.50 |"
    )
    assert row.endswith("| 2.0 | 1.5 min |")
    title, *_, row = markdown(results[:1], 0.1).splitlines()
    assert "images, 1 seed, γ" in title
    assert row.startswith("| posenet | 10 % | 10 % | 10 % | 50 % |")
    runs = [
        {
            "frames_with_true_pose": 100,
            "filter": {"success": right, "median_translation_m": metres, "median_rotation_deg": 1.0},
            "smoothed": {"success": True},
            "consistency": {"images": said, "wrong": wrong},
        }
        for right, metres, said, wrong in ((True, 0.1, 40, 0.0), (False, 3.0, 20, 0.5), (False, 4.0, 0, None))
    ]
    *_, row = markdown([results[0] | {"filter": runs}], 0.1).splitlines()
    assert row.endswith("| 1 of 3 | 3.00 m, 1.0° | 20 %, 17 % | 3 of 3 | 1.5 min |")
    *_, row = markdown([results[0] | {"filter": runs[2:]}], 0.1).splitlines()
    assert row.endswith("| 0 of 1 | 4.00 m, 1.0° | 0 %, – | 1 of 1 | 1.5 min |")


def test_scenes_are_synthetic_ones_or_named_data():
    scene = parse_scene("desk=a.mcap,b@0:10=c.mcap")
    assert (scene.name, scene.train, scene.test) == ("desk", ("a.mcap", "b@0:10"), ("c.mcap",))
    assert parse_scene("building-3").name == "building-3"
    for wrong in ("cellar", "building", "a=b", "a=b=c=d", "=b=c", "a=b,=c", "my/desk=b=c"):
        with pytest.raises(VaporTrackError, match="expected one of staircase"):
            parse_scene(wrong)


def test_a_table_is_not_judged_by_images_that_it_trains_on(tmp_path):
    scene, config = make_7scenes(tmp_path / "chess"), replace(TINY_TABLE, localize=False)
    (scene / "TrainSplit.txt").write_text("sequence1\n")
    one = scene / "seq-01"
    with pytest.raises(VaporTrackError, match=r"seq-01@7:: shares images with .*TrainSplit.txt, which is"):
        TableExperiment([parse_scene(f"desk={scene}/TrainSplit.txt={one}@7:")], tmp_path, config)
    twice, held_out = f"desk={one}@:5,{one}@4:5={one}@5:9", replace(config.train, validation_fraction=0.2)
    with pytest.raises(VaporTrackError, match=r"seq-01@4:5: shares images with .*seq-01@:5, which is"):
        TableExperiment([parse_scene(twice)], tmp_path, replace(config, train=held_out))
    TableExperiment([parse_scene(twice)], tmp_path, config)  # of which nothing is held out
    TableExperiment([parse_scene(f"desk={one}@0:5,{one}@9:={one}@5:9")], tmp_path, config)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"methods": ()}, "methods are none"),
        ({"methods": ("posenet", "lidar")}, "unknown method 'lidar'"),
        ({"seeds": 0}, "seeds"),
    ],
)
def test_a_table_that_cannot_be_is_refused(change, message):
    with pytest.raises(VaporTrackError, match=message):
        TableConfig(**change)


def test_the_same_scene_twice_is_refused(tmp_path):
    with pytest.raises(VaporTrackError, match="expected each at most once"):
        TableExperiment([parse_scene("ceiling")] * 2, tmp_path, TINY_TABLE)


@pytest.mark.parametrize(
    ("words", "experiment"),
    [
        (["table", "round-table", "--preset", "demo", "--preset", "tables", "--train.epochs", "3"], "TableExperiment"),
        (["schedule", "--preset=tables", "--train.epochs=3"], "ScheduleExperiment"),
    ],
)
def test_a_table_and_a_schedule_start_from_a_preset(words, experiment, monkeypatch, tmp_path):
    given = []
    monkeypatch.setattr(experiment_command, experiment, lambda *arguments: given.append(arguments[-1]) or sys.exit(0))
    with pytest.raises(SystemExit):
        main(["experiment", *words, "--output", str(tmp_path)])
    assert given[0].train == replace(PRESETS["tables"], epochs=3)


def test_an_unknown_preset_of_a_table_is_told(tmp_path, capfd):
    with pytest.raises(SystemExit, match="2"):
        main(["experiment", "table", "round-table", "--preset", "quick", "--output", str(tmp_path)])
    assert "vapor-track experiment table: unknown preset 'quick', expected one of auto," in capfd.readouterr().err


def test_data_that_the_filter_cannot_read_is_refused_before_anything_is_trained(tmp_path):
    one, recording = make_7scenes(tmp_path / "chess") / "seq-01", Walk(4).write(tmp_path / "walk.mcap")
    with pytest.raises(VaporTrackError, match="seq-01"):
        TableExperiment([parse_scene(f"desk={recording}={one}")], tmp_path, TINY_TABLE)


def test_results_of_other_data_of_the_same_name_are_not_taken_for_these(tmp_path):
    files = []
    for number, folder in enumerate(("chess", "fire")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "TrainSplit.txt").write_text(f"sequence{number}")
        files.append(
            TrainingRun(Scene("desk", (f"{tmp_path}/{folder}/TrainSplit.txt",), ("t",)), "x", TINY_TRAIN, 0.1, 10)
        )
    assert files[0].file(tmp_path, ".json") != files[1].file(tmp_path, ".json")
    assert files[0].model_file(tmp_path) != files[1].model_file(tmp_path)
    before = files[0].file(tmp_path, ".json")
    (tmp_path / "chess" / "TrainSplit.txt").write_text("another one")
    assert files[0].file(tmp_path, ".json") != before


@pytest.mark.parametrize("entry", ["TrainSplit.txt", "seq-01", "seq-01@2:5", ""])
def test_a_file_changed_inside_a_data_set_makes_another_training(entry, tmp_path, monkeypatch):
    scene = make_7scenes(tmp_path / "chess")
    (scene / "TrainSplit.txt").write_text("sequence1")
    training = TrainingRun(Scene("desk", (str(scene / entry),), (str(tmp_path / "t"),)), "x", TINY_TRAIN, 0.1, 10)
    before = training.file(tmp_path, ".json"), training.model_file(tmp_path)
    monkeypatch.chdir(tmp_path)
    relative = replace(training, scene=Scene("desk", (str(Path("chess") / entry),), (str(tmp_path / "t"),)))
    assert before[1] == relative.model_file(tmp_path)
    assert before == (training.file(tmp_path, ".json"), training.model_file(tmp_path))
    with open(scene / "seq-01" / "frame-000003.pose.txt", "a") as pose:
        pose.write("\n")
    after = training.file(tmp_path, ".json"), training.model_file(tmp_path)
    assert before[0] != after[0]
    assert before[1] != after[1]


def test_another_way_to_test_needs_no_other_training(tmp_path, monkeypatch):
    first = TableExperiment([parse_scene("round-table")], tmp_path, replace(TINY_TABLE, localize=False))
    list(first.render())
    before = list(first.train())
    monkeypatch.setattr(runs_module, "train_on_images", lambda *_, **__: pytest.fail("trained again"))
    again = TableExperiment([parse_scene("round-table")], tmp_path, replace(TINY_TABLE, localize=False, gamma=1.0))
    list(again.render())
    after = list(again.train())
    assert {r["label"]: r["negative_log_density"] for r in after} == pytest.approx(
        {r["label"]: r["negative_log_density"] for r in before}
    )


def test_a_training_that_fails_is_told_and_the_others_go_on(tmp_path):
    broken = replace(TINY_TRAIN, learning_rate=1e30, epochs=3, schedule="steps")
    config = replace(TINY_TABLE, methods=("posenet",), localize=False, train=broken)
    experiment = TableExperiment([parse_scene("round-table")], tmp_path, config)
    list(experiment.render())
    (result,) = experiment.train()
    assert "loss is" in result["error"]
    assert "round-table, posenet, seed 0: loss is" in markdown([result], 0.1)
