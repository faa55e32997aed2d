"""Methods side by side, in a table."""

import os
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from filtering.errors import VaporTrackError
from tests.helpers.data_sets import make_7scenes
from tests.helpers.full import full
from tests.helpers.sequence_files import Walk
from tests.helpers.tiny_training import TINY_TRAIN
from vapor.benchmark.__main__ import main
from vapor.benchmark.commands import regressors as command
from vapor.benchmark.regressors import training_runs as runs_module
from vapor.benchmark.regressors.table import TableConfig, TableExperiment, markdown, parse_scene
from vapor.benchmark.regressors.training_runs import Scene, TrainingRun, rendered_height
from vapor.regressors.network_config import NetworkConfig
from vapor.training.presets import PRESETS

pytestmark = pytest.mark.usefixtures("unchecked", "rough_light")

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


@full
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


def test_images_are_read_once_for_many_trainings_and_again_when_a_file_changes(tmp_path, monkeypatch):
    read = []
    load = runs_module.load_training_set
    monkeypatch.setattr(runs_module, "load_training_set", lambda s, *a, **k: read.append(list(s)) or load(s, *a, **k))
    monkeypatch.setattr(runs_module, "in_parallel", lambda function, jobs, _: (function(*job) for job in jobs))
    experiment = TableExperiment([parse_scene("round-table")], tmp_path, replace(TINY_TABLE, localize=False))
    list(experiment.render())
    list(experiment.train())
    assert len(read) == 2  # to train on and to test on, for two trainings
    (walk,) = (tmp_path / "images").glob("*-train-*")
    os.utime(walk)
    list(experiment.train())
    assert [len(names) for names in read] == [1, 1, 1]
    assert "train" in read[2][0]


@pytest.mark.parametrize(
    "network",
    [NetworkConfig(), PRESETS["tables"].network, PRESETS["resnet18"].network, NetworkConfig(image_width=320)],
)
def test_synthetic_images_are_never_enlarged_for_a_network(network):
    height = rendered_height(network.frame_size)
    assert height > network.frame_size[1]
    assert round(height * 4 / 3) > network.frame_size[0]


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


@pytest.mark.parametrize("words", [["--preset", "demo", "--preset", "tables"], ["--preset=tables"]])
def test_a_table_starts_from_a_preset(words, monkeypatch, tmp_path):
    given = []
    monkeypatch.setattr(command, "TableExperiment", lambda *arguments: given.append(arguments[2]) or sys.exit(0))
    with pytest.raises(SystemExit):
        main(["regressors", "round-table", *words, "--train.epochs", "3", "--output", str(tmp_path)])
    assert given[0].train == replace(PRESETS["tables"], epochs=3)


def test_an_unknown_preset_of_a_table_is_told(tmp_path, capfd):
    with pytest.raises(SystemExit, match="2"):
        main(["regressors", "round-table", "--preset", "quick", "--output", str(tmp_path)])
    assert "vapor-benchmark regressors: unknown preset 'quick', expected one of auto," in capfd.readouterr().err


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
    assert files[0].result_file(tmp_path) != files[1].result_file(tmp_path)
    assert files[0].model_file(tmp_path) != files[1].model_file(tmp_path)
    before = files[0].result_file(tmp_path)
    (tmp_path / "chess" / "TrainSplit.txt").write_text("another one")
    assert files[0].result_file(tmp_path) != before


@pytest.mark.parametrize("entry", ["TrainSplit.txt", "seq-01", "seq-01@2:5", ""])
def test_a_file_changed_inside_a_data_set_makes_another_training(entry, tmp_path, monkeypatch):
    scene = make_7scenes(tmp_path / "chess")
    (scene / "TrainSplit.txt").write_text("sequence1")
    training = TrainingRun(Scene("desk", (str(scene / entry),), (str(tmp_path / "t"),)), "x", TINY_TRAIN, 0.1, 10)
    before = training.result_file(tmp_path), training.model_file(tmp_path)
    monkeypatch.chdir(tmp_path)
    relative = replace(training, scene=Scene("desk", (str(Path("chess") / entry),), (str(tmp_path / "t"),)))
    assert before[1] == relative.model_file(tmp_path)
    assert before == (training.result_file(tmp_path), training.model_file(tmp_path))
    with open(scene / "seq-01" / "frame-000003.pose.txt", "a") as pose:
        pose.write("\n")
    after = training.result_file(tmp_path), training.model_file(tmp_path)
    assert before[0] != after[0]
    assert before[1] != after[1]


@full
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
    broken = replace(TINY_TRAIN, learning_rate=1e30, epochs=3, decay_epochs=50)
    config = replace(TINY_TABLE, methods=("posenet",), localize=False, train=broken)
    experiment = TableExperiment([parse_scene("round-table")], tmp_path, config)
    list(experiment.render())
    (result,) = experiment.train()
    assert "loss is" in result["error"]
    assert "round-table, posenet, seed 0: loss is" in markdown([result], 0.1)
