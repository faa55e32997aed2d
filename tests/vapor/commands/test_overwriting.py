"""What commands never replace: files of the user's, files that are read, and results of another kind."""

from pathlib import Path

import pytest

from tests.helpers.command_line import contents, main, refuse, words_of_run
from tests.helpers.data_sets import make_7scenes, make_colmap
from tests.helpers.tiny_model import SMALL

OUTPUTS = {
    "run": ["run", "walk.mcap", "--model", "m.safetensors", "--output"],
    "a batch": ["run", "walk.mcap", "gone.mcap", "--model", "m.safetensors", "--output"],
    "fuse": ["fuse", "truth.tum", "--simulate-odometry", "truth.tum", "--output"],
    "demo": ["demo", "--output"],
    "inspect": ["inspect", "walk.mcap", "--output"],
    "benchmark": ["vapor-benchmark", "localization", "ceiling", "--models", "m.safetensors", "--output"],
    "faults": ["vapor-benchmark", "faults", "ceiling", "--models", "m.safetensors", "--output"],
    "recorded faults": [
        *("vapor-benchmark", "faults", "--recordings", "walk.mcap", "--models", "m.safetensors", "--output")
    ],
    "real": ["vapor-benchmark", "real", "--data", "real", "--only", "stairs_hloc", "--output"],
    "table": ["vapor-benchmark", "regressors", "round-table", "--output"],
    "synthesize": ["synthesize", "round-table"],
    "convert": ["convert", "data"],
    "map": ["map", "walk.mcap", "--output"],
    "posterior": ["posterior", "walk.mcap", "--model", "m.safetensors", "--output"],
    "train": ["train", "walk.mcap", "--output"],
    "calibrate": ["calibrate", "m.safetensors", "walk.mcap", "--output"],
    "evaluate": ["evaluate", "earlier", "--output"],
    "export": ["export", "m.safetensors"],
}

FILES = dict.fromkeys(("synthesize", "convert", "train", "calibrate"), "notes.txt") | {
    "posterior": "photo.png",
    "evaluate": "report.json",
    "export": "notes.onnx",
}
"""Commands that write one file, and a file of the user's that looks like one of theirs where they tell by the name."""

pytestmark = pytest.mark.usefixtures("rough_light")


@pytest.fixture
def belongings(walk_of_25, tiny_model, earlier, monkeypatch) -> Path:
    """The working directory, with a sequence, a model, and things of the user's under names of results."""
    folder = earlier.parent
    monkeypatch.chdir(folder)
    (folder / "walk.mcap").write_bytes(walk_of_25.read_bytes())
    (folder / "m.safetensors").write_bytes(tiny_model.read_bytes())
    for name in ("report.json", "summary.json", "walk/trajectory.tum", "notes.txt", "photo.png", "notes.onnx"):
        (folder / "mine" / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / "mine" / name).write_text("mine")
    for link in ("link", "link.onnx"):
        (folder / link).symlink_to("nowhere")
    for file in ("stairs_test.txt", "estimates/stairs_hloc.txt"):
        (folder / "real" / "7scenes_stairs" / file).parent.mkdir(parents=True, exist_ok=True)
        (folder / "real" / "7scenes_stairs" / file).write_text("mine")
    (folder / "real" / "7scenes_redkitchen" / "seq-01").mkdir(parents=True)
    return folder


def test_the_state_of_a_training_replaces_no_file_of_another_kind(belongings, capsys):
    (belongings / "new.training.safetensors").write_text("mine")
    before = contents(belongings)
    refuse([*OUTPUTS["train"], "new.safetensors"], capsys, "new.training.safetensors", "--overwrite")
    assert contents(belongings) == before


@pytest.mark.parametrize("name", OUTPUTS)
def test_no_command_replaces_what_no_command_wrote(name, belongings, capsys):
    before = contents(belongings)
    link = "link.onnx" if name == "export" else "link"  # export looks at the names of outputs first
    refuse([*OUTPUTS[name], f"mine/{FILES[name]}" if name in FILES else "mine"], capsys, "mine", "--overwrite")
    refuse([*OUTPUTS[name], link], capsys, f"{link}: is a link to nowhere, which does not exist")
    with pytest.raises(SystemExit) as stopped:
        main([*OUTPUTS[name], " "])
    assert stopped.value.code == 2
    assert contents(belongings) == before


@pytest.mark.parametrize(
    ("name", "own"), [("synthesize", "walk.mcap"), ("calibrate", "earlier.safetensors"), ("train", "m.safetensors")]
)
def test_files_of_the_same_kind_are_replaced(name, own, belongings, capsys):
    """What is refused here is the rest of the words: the output was found to be such a file."""
    (belongings / "earlier.safetensors").write_bytes((belongings / "m.safetensors").read_bytes())
    words = {"synthesize": ["synthesize", "nowhere"], "train": ["train", "gone.mcap", "--output"]}
    words["calibrate"] = ["calibrate", "m.safetensors", "gone.mcap", "--output"]
    if name == "synthesize":
        with pytest.raises(SystemExit):
            main([*words[name], own])
        assert "nowhere" in capsys.readouterr().err
    else:
        refuse([*words[name], own], capsys, "gone.mcap")


IMAGE, POSE = "data/seq-01/frame-000003.color.png", "data/seq-01/frame-000003.pose.txt"

READ = {
    "train": (["train", "walk.mcap@0:9", "--output"], ["walk.mcap"]),
    "validation": (["train", "walk.mcap", "--validation", "notes.txt", "--output"], ["notes.txt"]),
    "weights": (
        ["train", "walk.mcap", "--pretrained-weights", "m.training.safetensors", "--output"],
        ["m.training.safetensors", "m.safetensors"],  # beside which the state of the training lies
    ),
    "initial model": ([*OUTPUTS["train"][:-1], "--initial-model", "m.safetensors", "--output"], ["m.safetensors"]),
    "poses": (["train", "walk.mcap", "--poses", "truth.tum", "--output"], ["truth.tum", "times.txt"]),
    "data set": (["train", "data", "--output"], [IMAGE, POSE]),
    "list": (["train", "data/TrainSplit.txt", "--output"], ["data/TrainSplit.txt", IMAGE]),
    "camera": (["train", "data/seq-01", "--output"], ["data/intrinsics.json"]),
    "images elsewhere": (["train", "colmap/sparse/0", "--output"], ["colmap/images/a/frame9.png"]),
    "calibrate": (["calibrate", "m.safetensors", "walk.mcap", "--output"], ["m.safetensors", "walk.mcap"]),
    "training": (["calibrate", "m.safetensors", "gone.mcap", "--training", "data", "--output"], [IMAGE]),
    "calibrate's poses": (["calibrate", "m.safetensors", "d", "--poses", "truth.tum", "--output"], ["truth.tum"]),
    "convert": (["convert", "data"], [IMAGE, POSE]),
    "map": (["map", "data", "--output"], ["data"]),
    "odometry": (["convert", "data", "--odometry", "truth.tum"], ["truth.tum"]),
    "posterior": (["posterior", "data", "--model", "m.safetensors", "--output"], ["m.safetensors", IMAGE]),
    "evaluate": (["evaluate", "earlier", "--output"], ["earlier/trajectory.tum", "earlier/manifest.json"]),
    "evaluate's truth": (["evaluate", "mine", "--output"], ["mine/ground_truth.tum"]),
    "other truth": (["evaluate", "earlier", "--ground-truth", "truth.tum", "--output"], ["truth.tum"]),
    "run": (["run", "walk.mcap", "--model", "config.json", "--output"], ["."]),
    "run's poses": ([*OUTPUTS["run"][:-1], "--poses", "mine/ground_truth.tum", "--output"], ["mine"]),
    "a batch": (["run", "walk.mcap", "walk/estimate.mcap", "--model", "m.safetensors", "--output"], ["."]),
    "fuse": (["fuse", "trajectory.tum", "--simulate-odometry", "truth.tum", "--output"], ["."]),
    "inspect": (["inspect", "data", "--output"], ["data", "data/seq-01"]),
    "inspect's model": (["inspect", "data", "--model", "report.json", "--output"], ["."]),
    "inspect's poses": (["inspect", "walk.mcap", "--poses", "map.png", "--output"], ["."]),
    "benchmark": (OUTPUTS["benchmark"], ["."]),
    "faults": (OUTPUTS["faults"], ["."]),
    "recorded faults": (OUTPUTS["recorded faults"], ["."]),
    "real": (["vapor-benchmark", "real", "--data", "real", "--output"], [".", "real/7scenes_stairs"]),
    "table's model": ([*OUTPUTS["table"][:-1], "--train.initial-model", "m.safetensors", "--output"], ["."]),
    "table's weights": ([*OUTPUTS["table"][:-1], "--train.pretrained-weights", "m.safetensors", "--output"], ["."]),
    "table": (["vapor-benchmark", "regressors", "own=data=walk.mcap", "--output"], [".", "data/seq-01"]),
}
"""Words of a command that reads, and outputs that are read, or that hold or lie in what is."""


@pytest.mark.parametrize("name", READ)
def test_what_a_command_reads_is_never_written_to(name, belongings, capsys):
    make_7scenes(belongings / "data", num_images=4)
    make_colmap(belongings / "colmap", "sparse/0", "images")
    (belongings / "data" / "TrainSplit.txt").write_text("sequence1\n")
    for copy in ("config.json", "report.json", "m.training.safetensors"):
        (belongings / copy).write_bytes((belongings / "m.safetensors").read_bytes())
    for file in (
        *("walk/estimate.mcap", "mine/ground_truth.tum", "data/intrinsics.json", "data/seq-01/map.png", "map.png"),
        *("notes.txt", "times.txt", "truth.tum", "trajectory.tum"),
    ):
        (belongings / file).parent.mkdir(parents=True, exist_ok=True)
        (belongings / file).write_text("mine")
    before = contents(belongings)
    words, outputs = READ[name]
    for output in outputs:
        refuse([*words, output, "--overwrite"], capsys, "read")
    assert contents(belongings) == before


@pytest.mark.usefixtures("unchecked", "plain_results")
def test_the_folder_of_the_sequence_is_only_taken_when_told_and_keeps_what_is_in_it(belongings, capsys):
    folder = belongings / "own"
    folder.mkdir()
    (belongings / "walk.mcap").rename(folder / "walk.mcap")
    (folder / "ground_truth.tum").write_text("mine")
    (folder / "config.json").write_text("mine")
    before = contents(folder)
    words = ["run", "own/walk.mcap", "--model", "m.safetensors", "--output", "own", "--ground-truth-topic", "", *SMALL]
    words += ["--duration-s", "0.5"]
    refuse(
        words, capsys, "own: holds config.json, ground_truth.tum and walk.mcap (which is read), expected", "--overwrite"
    )
    assert contents(folder) == before
    assert main([*words, "--no-recording", "--overwrite"]) == 0
    after = contents(folder)
    assert {name for name in before if after[name] != before[name]} == {"config.json"}


@pytest.mark.usefixtures("unchecked", "plain_results")
def test_an_interrupted_run_leaves_nothing_and_ends_with_130(walk_of_25, tiny_model, earlier, capsys, monkeypatch):
    before = contents(earlier)

    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("filtering.smoothing.smooth", interrupt)
    assert main([*words_of_run(walk_of_25, tiny_model, earlier), "--duration-s", "0.5"]) == 130
    assert capsys.readouterr().err == "vapor-track run: interrupted\n"
    assert contents(earlier) == before
