"""Methods side by side, in a table."""

import json
import os
import shutil
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
from vapor.benchmark.commands.regressors import TableConfig, check_scenes, parse_scene, with_files
from vapor.benchmark.regressors import training_runs as runs_module
from vapor.benchmark.regressors.table import failures, scene_tables
from vapor.benchmark.regressors.training_runs import Scene, TrainingRun, carry_out, rendered_height
from vapor.regressors.network_config import NetworkConfig
from vapor.training import state as state_module
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


def results_of(scene: str, directory: Path, config: TableConfig) -> list[dict]:
    """Render a synthetic scene, and carry out its training runs."""
    for walk in config.synthetic_walks(scene):
        walk.render(directory)
    runs = config.runs([with_files(parse_scene(scene), config, directory)])
    return [carry_out(run, directory) for run in runs]


def rows_of(results: list[dict]) -> list[tuple]:
    """Cells of the table of the one scene."""
    (table,) = scene_tables(results, 0.1).values()
    return list(zip(*(column.cells for column in table.columns), strict=True))


@full
def test_methods_are_trained_and_drive_the_filter(tmp_path):
    results = results_of("staircase", tmp_path, TINY_TABLE)
    assert {r["label"] for r in results} == {"variational", "posenet"}
    for result in results:
        assert result["filter"][0]["frames"] == 12
        assert result["images_seen"] == 40
    assert [row[0] for row in rows_of(results)] == ["variational", "posenet"]
    assert "0 of 1" in rows_of(results)[0]


def test_images_are_read_once_for_many_trainings_and_again_when_a_file_changes(tmp_path, monkeypatch):
    read = []
    load = runs_module.load_training_set
    monkeypatch.setattr(runs_module, "load_training_set", lambda s, *a, **k: read.append(list(s)) or load(s, *a, **k))
    config = replace(TINY_TABLE, localize=False)
    results_of("round-table", tmp_path, config)
    assert len(read) == 2  # to train on and to test on, for two trainings
    (walk,) = (tmp_path / "images").glob("*-train-*")
    os.utime(walk)
    results_of("round-table", tmp_path, config)
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
    assert failures(results) == ["hall, mapnet, seed 0: loss is nan"]
    (table,) = scene_tables(results, 0.1).values()
    assert table.title == "hall, 10 test images, 3 seeds, γ = 0.1"
    (row,) = rows_of(results)
    errors = ("0.25 m, 3.0°", "0.15 m, 2.0°")
    assert row == ("posenet", *["20 % (10-40)"] * 3, "50 %", "100 %", *errors, "1.50", "2.0", "1.5 min")
    (row,) = rows_of(results[:1])
    assert row[:5] == ("posenet", "10 %", "10 %", "10 %", "50 %")
    runs = [
        {
            "frames_with_true_pose": 100,
            "filter": {"success": right, "median_translation_m": metres, "median_rotation_deg": 1.0},
            "smoothed": {"success": True},
            "consistency": {"images": said, "wrong": wrong},
        }
        for right, metres, said, wrong in ((True, 0.1, 40, 0.0), (False, 3.0, 20, 0.5), (False, 4.0, 0, None))
    ]
    (row,) = rows_of([results[0] | {"filter": runs}])
    assert row[-5:] == ("1 of 3", "3.00 m, 1.0°", "20 %, 17 %", "3 of 3", "1.5 min")
    (row,) = rows_of([results[0] | {"filter": runs[2:]}])
    assert row[-5:] == ("0 of 1", "4.00 m, 1.0°", "0 %, –", "1 of 1", "1.5 min")


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
    with pytest.raises(VaporTrackError, match=r"seq-01@7:: shares images with .*TrainSplit\.txt; expected"):
        check_scenes([parse_scene(f"desk={scene}/TrainSplit.txt={one}@7:")], config)
    twice, held_out = f"desk={one}@:5,{one}@4:5={one}@5:9", replace(config.train, validation_fraction=0.2)
    with pytest.raises(VaporTrackError, match=r"seq-01@4:5: shares images with .*seq-01@:5; expected"):
        check_scenes([parse_scene(twice)], replace(config, train=held_out))
    check_scenes([parse_scene(twice)], config)  # of which nothing is held out
    check_scenes([parse_scene(f"desk={one}@0:5,{one}@9:={one}@5:9")], config)


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
        check_scenes([parse_scene("ceiling")] * 2, TINY_TABLE)


@pytest.mark.parametrize("words", [["--preset", "demo", "--preset", "tables"], ["--preset=tables"]])
def test_a_table_starts_from_a_preset(words, monkeypatch, tmp_path):
    monkeypatch.setattr(command, "completed", lambda *_: [])
    assert main(["regressors", "round-table", *words, "--train.epochs", "3", "--output", str(tmp_path)]) == 0
    train = json.loads((tmp_path / "table.json").read_text())["settings"]["train"]
    assert (train["epochs"], train["batch_size"]) == (3, PRESETS["tables"].batch_size)
    assert train["network"]["feature_dim"] == PRESETS["tables"].network.feature_dim


def test_an_unknown_preset_of_a_table_is_told(tmp_path, capfd):
    with pytest.raises(SystemExit, match="2"):
        main(["regressors", "round-table", "--preset", "quick", "--output", str(tmp_path)])
    assert "vapor-benchmark regressors: unknown preset 'quick', expected one of auto," in capfd.readouterr().err


def test_data_that_the_filter_cannot_read_is_refused_before_anything_is_trained(tmp_path):
    one, recording = make_7scenes(tmp_path / "chess") / "seq-01", Walk(4).write(tmp_path / "walk.mcap")
    with pytest.raises(VaporTrackError, match="seq-01"):
        check_scenes([parse_scene(f"desk={recording}={one}")], TINY_TABLE)


def test_results_of_other_data_of_the_same_name_are_not_taken_for_these(tmp_path):
    files = []
    for number, folder in enumerate(("chess", "fire")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "TrainSplit.txt").write_text(f"sequence{number}")
        files.append(
            TrainingRun(Scene("desk", (f"{tmp_path}/{folder}/TrainSplit.txt",), ("t",)), "x", TINY_TRAIN, 0.1, 10)
        )
    assert files[0].settings() != files[1].settings()
    assert files[0].model_file(tmp_path) != files[1].model_file(tmp_path)
    before = files[0].settings()
    (tmp_path / "chess" / "TrainSplit.txt").write_text("another one")
    assert files[0].settings() != before


@pytest.mark.parametrize("entry", ["TrainSplit.txt", "seq-01", "seq-01@2:5", ""])
def test_a_file_changed_inside_a_data_set_makes_another_training(entry, tmp_path, monkeypatch):
    scene = make_7scenes(tmp_path / "chess")
    (scene / "TrainSplit.txt").write_text("sequence1")
    training = TrainingRun(Scene("desk", (str(scene / entry),), (str(tmp_path / "t"),)), "x", TINY_TRAIN, 0.1, 10)
    before = training.settings(), training.model_file(tmp_path)
    monkeypatch.chdir(tmp_path)
    relative = replace(training, scene=Scene("desk", (str(Path("chess") / entry),), (str(tmp_path / "t"),)))
    assert before[1] == relative.model_file(tmp_path)
    assert before == (training.settings(), training.model_file(tmp_path))
    with open(scene / "seq-01" / "frame-000003.pose.txt", "a") as pose:
        pose.write("\n")
    after = training.settings(), training.model_file(tmp_path)
    assert before[0] != after[0]
    assert before[1] != after[1]


@full
def test_another_way_to_test_needs_no_other_training(tmp_path, monkeypatch):
    config = replace(TINY_TABLE, localize=False)
    before = results_of("round-table", tmp_path, config)
    monkeypatch.setattr(runs_module, "train_on_images", lambda *_, **__: pytest.fail("trained again"))
    after = results_of("round-table", tmp_path, replace(config, gamma=1.0))
    assert {r["label"]: r["negative_log_density"] for r in after} == pytest.approx(
        {r["label"]: r["negative_log_density"] for r in before}
    )


def test_a_training_that_fails_is_told_and_the_others_go_on(tmp_path):
    broken = replace(TINY_TRAIN, learning_rate=1e30, epochs=3, decay_epochs=50)
    config = replace(TINY_TABLE, methods=("posenet",), localize=False, train=broken)
    (result,) = results_of("round-table", tmp_path, config)
    assert failures([result])[0].startswith("round-table, posenet, seed 0: loss is")


def test_a_training_that_was_interrupted_goes_on_to_the_same_result(tmp_path, monkeypatch):
    config = replace(TINY_TABLE, methods=("variational",), localize=False, train=replace(TINY_TRAIN, epochs=2))
    whole = results_of("dinner-table", tmp_path / "whole", config)
    shutil.copytree(tmp_path / "whole" / "images", tmp_path / "parts" / "images")  # copies have the same times
    save, epochs = state_module.save_state, []

    def interrupted(path: Path, *state: object) -> None:
        save(path, *state)  # pyright: ignore[reportArgumentType]
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(state_module, "save_state", interrupted)
        with pytest.raises(KeyboardInterrupt):
            results_of("dinner-table", tmp_path / "parts", config)
    monkeypatch.setattr(state_module, "save_state", lambda *state: save(*state) or epochs.append(state[0]))
    parts = results_of("dinner-table", tmp_path / "parts", config)
    assert [each | {"seconds": None} for each in parts] == [each | {"seconds": None} for each in whole]
    assert len(epochs) == 1  # the other one was done
    assert not list((tmp_path / "parts" / "runs").glob("*.training.safetensors"))
