"""The command from outside: exit status, the one line on standard error, and what is left on disk."""

import json
import os
import subprocess
import sys
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import numpy as np
import pytest
import torch

from filtering.se3 import Poses
from sequences.frame import Trajectory
from sequences.outputs.results import results_folder
from sequences.paths import choose
from sequences.reader import SequenceReader
from sequences.synthesize import synthesize
from sequences.trajectories.tum import read_tum, write_tum
from tests import sequence_files
from tests.data_sets import make_7scenes, make_colmap, make_tum, truth_at
from tests.sequence_files import BEGIN_NS, Walk, rewrite
from tests.tiny_model import SMALL, altered
from vapor.checkpoints import shipped_models
from vapor.track import COMMANDS, main
from vapor.training import trainer as trainer_module
from vapor.training.presets import PRESETS

IMAGES, ODOMETRY, TRUTH = "/camera/image/compressed", "/odom", "/ground_truth/pose"
NOWHERE = Poses(np.eye(3), np.array([np.nan, 0.0, 0.0]))


def words_of_run(sequence: Path | str, model: Path | str, output: Path) -> list[str]:
    return ["run", str(sequence), "--model", str(model), "--output", str(output), *SMALL, "--no-recording"]


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def refuse(words: list[str], capsys: pytest.CaptureFixture[str], *said: object) -> str:
    """Check that the command fails with status 1 and one line that says all of `said`; gives the line."""
    capsys.readouterr()
    status = main(words)
    out, err = capsys.readouterr()
    assert status == 1, err
    assert out == ""
    assert err.startswith(f"vapor-track {words[0]}: ")
    assert err.endswith("\n")
    assert err.count("\n") == 1
    for words_said in said:
        assert str(words_said) in err
    return err


@pytest.fixture
def earlier(tmp_path: Path) -> Path:
    """A directory that already holds results, which must stay as they are."""
    folder, names = tmp_path / "earlier", ("report.json", "trajectory.tum")
    with results_folder(folder, "run", writes=names) as new:
        for name in names:
            (new / name).write_text("an earlier result\n")
    return folder


def refuse_run(sequence: Path, model: Path | str, earlier: Path, capsys: pytest.CaptureFixture[str], *said: object):
    """`refuse`, into a new directory and into one that holds a result: neither may change."""
    inputs = contents(earlier.parent)
    new = earlier.parent / "new"
    line = refuse(words_of_run(sequence, model, new), capsys, *said)
    assert not new.exists()
    assert refuse(words_of_run(sequence, model, earlier), capsys) == line
    assert contents(earlier.parent) == inputs


def skipped_in_run(sequence: Path, model: Path, output: Path) -> tuple[int, dict[str, int]]:
    assert main(words_of_run(sequence, model, output)) == 0
    report = json.loads((output / "report.json").read_text())
    return report["frames"], report["skipped"]


# --- sequences that cannot be used ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("lacking", "said"),
    [
        (IMAGES, ["no image topic", "sensor_msgs/Image or sensor_msgs/CompressedImage", "/odom (nav_msgs/Odometry)"]),
        (ODOMETRY, ["no odometry topic", "expected one of type nav_msgs/Odometry", "--odometry-frame"]),
        ("/tf_static", ["no transform from 'base_link' (/odom", "'camera_optical_frame'", "--base-from-camera"]),
    ],
)
def test_a_sequence_that_lacks_a_topic_is_refused(lacking, said, walk_of_25, tiny_model, earlier, capsys):
    path = rewrite(walk_of_25, earlier.parent / "poor.mcap", keep=lambda topic, _: topic != lacking)
    refuse_run(path, tiny_model, earlier, capsys, path.name, *said)


@pytest.mark.parametrize("name", ["nav2_turtlebot.mcap", "talker.mcap", "only_topics.mcap"])
def test_recordings_of_real_robots_without_images_are_refused(name, shared_data, tiny_model, earlier, capsys):
    path = shared_data / "ros_bags" / name
    refuse_run(path, tiny_model, earlier, capsys, path, "no image topic, expected one of type sensor_msgs/Image")


def test_a_real_ros_1_bag_is_refused_with_advice(shared_data, tiny_model, earlier, capsys):
    path = shared_data / "ros_bags" / "t265_trimmed_locoffice.bag"
    refuse_run(path, tiny_model, earlier, capsys, path, "ROS 1 bag; convert it first", "expected an MCAP file")


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "expected the MCAP magic"),
        (b"hello, world" * 50, "starts with b'hello, w', expected the MCAP magic"),
        (b"#ROSBAG V2.0\n" + bytes(99), "ROS 1 bag; convert it first"),
        (b"SQLite format 3\0" + bytes(99), "SQLite"),
    ],
)
def test_garbage_is_refused(content, said, tiny_model, earlier, capsys):
    path = earlier.parent / "garbage.mcap"
    path.write_bytes(content)
    refuse_run(path, tiny_model, earlier, capsys, path, said)


@pytest.mark.parametrize("share", [0.02, 0.5, 0.999])
def test_a_truncated_recording_is_refused(share, walk_of_25, tiny_model, earlier, capsys):
    path = earlier.parent / "cut.mcap"
    content = walk_of_25.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    refuse_run(path, tiny_model, earlier, capsys, path, "truncated", "expected the closing MCAP magic")


@pytest.mark.usefixtures("unchecked")
def test_damage_that_is_met_half_way_leaves_nothing_behind(walk_of_25, tiny_model, earlier, capsys):
    path = rewrite(walk_of_25, earlier.parent / "damaged.mcap", chunk_size=2000)
    content = bytearray(path.read_bytes())
    last_image = content.rindex(b"\x89PNG\r\n")
    content[last_image + 60] ^= 0xFF
    path.write_bytes(content)
    frames = iter(SequenceReader(path))
    assert all(next(frames) for _ in range(10))  # the damage lies behind these
    refuse_run(path, tiny_model, earlier, capsys, path, "damaged MCAP near byte", "expected")


def test_a_sequence_or_folder_that_is_absent_or_empty_is_refused(tiny_model, earlier, capsys):
    refuse_run(
        earlier.parent / "no.mcap", tiny_model, earlier, capsys, "no.mcap: no such file", "expected an .mcap file"
    )
    (earlier.parent / "bag").mkdir()
    refuse_run(earlier.parent / "bag", tiny_model, earlier, capsys, "bag: folder has no metadata.yaml", "rosbag2")


def test_of_two_image_topics_one_must_be_named(walk_of_25, tiny_model, earlier, capsys):
    left = rewrite(walk_of_25, earlier.parent / "left.mcap", topic_names={IMAGES: "/left/image/compressed"})
    bag = earlier.parent / "bag"
    bag.mkdir()
    for source, name in ((walk_of_25, "bag_0.mcap"), (left, "bag_1.mcap")):
        rewrite(source, bag / name)
    (bag / "metadata.yaml").write_text("  relative_file_paths:\n  - bag_0.mcap\n  - bag_1.mcap\n")
    refuse_run(
        bag, tiny_model, earlier, capsys, bag, "2 image topics", "--image-topic", IMAGES, "/left/image/compressed"
    )


def test_a_transform_that_is_not_finite_is_named(tiny_model, earlier, capsys, monkeypatch):
    walk = Walk(5)
    monkeypatch.setattr(sequence_files, "BASE_FROM_CAMERA", NOWHERE)
    path = walk.write(earlier.parent / "walk.mcap")
    refuse_run(path, tiny_model, earlier, capsys, path, "/tf_static", "transform base_link -> camera_optical_frame")


# --- images and messages that are left out -------------------------------------------------------------


def without_images(walk: Walk) -> None:
    walk.images = [(t, b"no image") for t, _ in walk.images]


def with_odometry_of_another_day(walk: Walk) -> None:
    walk.odometry = [(t + 86_400 * 10**9, pose) for t, pose in walk.odometry]


@pytest.mark.usefixtures("unchecked", "plain_results")
def test_what_is_left_out_is_counted_in_the_report_and_told(tiny_model, tmp_path, capsys):
    walk, second = Walk(30), 1_000_000_000
    walk.odometry = [(t, pose) for t, pose in walk.odometry if t > BEGIN_NS + 0.25 * second]  # not images 0 to 2
    walk.images[6] = (walk.images[6][0], b"no image")
    walk.images[9] = (walk.images[9][0], walk.images[9][1][:40])
    walk.images.append(walk.images[14])  # a stamp twice

    def logged(topic: str, time_ns: int) -> int:
        return time_ns + 7 * second // 10 * (
            topic == IMAGES and time_ns == BEGIN_NS + 2 * second
        )  # after its successors

    path = rewrite(walk.write(tmp_path / "in.mcap"), tmp_path / "walk.mcap", log_time=logged)
    frames, skipped = skipped_in_run(path, tiny_model, tmp_path / "out")
    assert skipped == {
        "odometry does not cover": 3,
        "time stamp not increasing": 2,
        "undecodable image": 1,
        "damaged image": 1,  # it is cut
    }
    assert frames == 30 + 1 - 3 - 2 - 2
    images = json.loads((tmp_path / "out" / "report.json").read_text())["images"]
    assert images == {"stated": 31, "read": 31, "used": 24, "skipped": skipped}
    out, err = capsys.readouterr()
    assert "images     31 stated, 31 read, 24 used, 7 skipped" in out
    assert all(f"skipped {count}: {reason}" in out for reason, count in skipped.items())
    assert err == ""
    assert read_tum(tmp_path / "out" / "trajectory.tum").poses.is_finite().all()
    assert "NaN" not in (tmp_path / "out" / "report.json").read_text()


@pytest.mark.usefixtures("unchecked", "plain_results")
def test_a_run_that_used_few_of_its_images_says_so_last_and_one_that_used_hardly_any_fails(
    tiny_model, earlier, tmp_path, capsys
):
    walk = Walk(40)
    walk.odometry = [(t, pose) for t, pose in walk.odometry if t < BEGIN_NS + 10**9]
    path = walk.write(earlier.parent / "walk.mcap")
    assert main(words_of_run(path, tiny_model, tmp_path / "few")) == 0
    last = "Only 10 of 40 images were used: 30 were skipped, odometry does not cover."
    assert capsys.readouterr().out.splitlines()[-1] == last

    before = contents(earlier)
    words = [*words_of_run(path, tiny_model, earlier), "--start-s", "0.8"]
    refuse(words, capsys, f"{path}: Only 2 of 32 images were used: 30 were skipped", "--allow-few-images")
    assert contents(earlier) == before
    assert main([*words, "--allow-few-images"]) == 0
    report = json.loads((earlier / "report.json").read_text())
    assert report["images"] == {
        "stated": 40,
        "read": 40,
        "used": 2,
        "skipped": {"odometry does not cover": 30, "outside the stretch asked for": 8},
    }


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (without_images, [f"no image left of 12 on {IMAGES}", "12 × undecodable image", "expected JPEG, PNG"]),
        (with_odometry_of_another_day, ["no image has odometry", "they begin 86400.0 s apart"]),
    ],
)
def test_where_no_image_is_left_the_run_fails_and_says_why(spoil, said, tiny_model, earlier, capsys):
    walk = Walk()
    spoil(walk)
    path = walk.write(earlier.parent / "walk.mcap")
    refuse_run(path, tiny_model, earlier, capsys, path.name, *said)


@pytest.mark.parametrize(("stream", "topic"), [("odometry", "/odom"), ("truth", "/ground_truth/pose")])
def test_a_pose_that_is_not_finite_is_named_with_topic_and_time(stream, topic, tiny_model, earlier, capsys):
    walk = Walk()
    time_ns = getattr(walk, stream)[5][0]
    getattr(walk, stream)[5] = (time_ns, NOWHERE)
    path = walk.write(earlier.parent / "walk.mcap")
    refuse_run(path, tiny_model, earlier, capsys, f"{path}: {topic} at {time_ns} ns", "not finite")


# --- models and outputs that cannot be used ------------------------------------------------------------

HEAD = "network.latent_mean.weight"


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda t, m: m.update(version="1"), "format version is '1', expected '8', '7' or '6', or '4' or '5' of which"),
        (lambda t, m: m.update(format="other"), "format is 'other'"),
        (lambda t, m: t.pop(HEAD), f"lacks tensor {HEAD} (1 such), expected exactly the"),
        (lambda t, m: t.update({"network.more": torch.zeros(1)}), "has surplus tensor network.more"),
        (lambda t, m: t.update({HEAD: torch.zeros(4, 15)}), f"{HEAD} has shape (4, 15), expected (4, 16)"),
        (lambda t, m: t.update({HEAD: torch.full((4, 16), torch.nan)}), f"{HEAD} has values that are not finite"),
    ],
)
def test_a_model_of_other_content_is_refused(change, said, walk_of_25, tiny_model, earlier, capsys):
    model = altered(tiny_model, earlier.parent / "other.safetensors", change)
    refuse_run(walk_of_25, model, earlier, capsys, model, said)


@pytest.mark.parametrize("content", [b"", b"no model", b"\x80\x04pickled" * 100])
def test_a_model_that_is_no_safetensors_file_is_refused(content, walk_of_25, earlier, capsys):
    model = earlier.parent / "m.safetensors"
    model.write_bytes(content)
    refuse_run(walk_of_25, model, earlier, capsys, model, "expected a safetensors file")


def test_an_unknown_model_is_refused_with_a_list_of_those_that_ship(walk_of_25, tmp_path, capsys, monkeypatch):
    shipped = tmp_path / "models"
    shipped.mkdir()
    for name in ("staircase", "ceiling"):
        (shipped / f"{name}.safetensors").write_bytes(b"")
    monkeypatch.setattr(shipped_models, "SHIPPED", shipped)
    refuse(words_of_run(walk_of_25, "atrium", tmp_path / "out"), capsys, "atrium: no such model", "ceiling, staircase")
    assert not (tmp_path / "out").exists()


def test_an_output_that_is_or_lies_in_a_file_is_refused(walk_of_25, tiny_model, tmp_path, capsys):
    (tmp_path / "file").write_text("mine")
    words = words_of_run(walk_of_25, tiny_model, tmp_path / "file")
    refuse(words, capsys, tmp_path / "file", "is a file, expected a directory")
    words = words_of_run(walk_of_25, tiny_model, tmp_path / "file" / "out")
    refuse(words, capsys, tmp_path / "file" / "out", "cannot write", "expected a directory")
    assert contents(tmp_path) == {"file": b"mine"}


OUTPUTS = {
    "run": ["run", "walk.mcap", "--model", "m.safetensors", "--output"],
    "a fleet": ["run", "walk.mcap", "gone.mcap", "--model", "m.safetensors", "--output"],
    "fuse": ["fuse", "truth.tum", "--simulate-odometry", "truth.tum", "--output"],
    "demo": ["demo", "--output"],
    "inspect": ["inspect", "walk.mcap", "--output"],
    "benchmark": ["benchmark", "localization", "ceiling", "--models", "m.safetensors", "--output"],
    "faults": ["benchmark", "faults", "ceiling", "--models", "m.safetensors", "--output"],
    "recorded faults": ["benchmark", "faults", "--recordings", "walk.mcap", "--models", "m.safetensors", "--output"],
    "real": ["benchmark", "real", "--data", "real", "--only", "stairs_hloc", "--output"],
    "alpha": ["experiment", "alpha", "round-table", "--output"],
    "decay": ["experiment", "decay", "--output"],
    "schedule": ["experiment", "schedule", "--output"],
    "table": ["experiment", "table", "round-table", "--output"],
    "synthesize": ["synthesize", "round-table"],
    "convert": ["convert", "data"],
    "posterior": ["posterior", "walk.mcap", "--model", "m.safetensors", "--output"],
    "train": ["train", "walk.mcap", "--output"],
    "calibrate": ["calibrate", "m.safetensors", "walk.mcap", "--output"],
    "evaluate": ["evaluate", "earlier", "--output"],
}
FILES = ("synthesize", "convert", "posterior", "train", "calibrate", "evaluate")


@pytest.fixture
def belongings(walk_of_25, tiny_model, earlier, monkeypatch) -> Path:
    """The working directory, with a sequence, a model, and things of the user's under names of results."""
    folder = earlier.parent
    monkeypatch.chdir(folder)
    (folder / "walk.mcap").write_bytes(walk_of_25.read_bytes())
    (folder / "m.safetensors").write_bytes(tiny_model.read_bytes())
    for name in ("report.json", "summary.json", "walk/trajectory.tum", "notes.txt", "photo.png"):
        (folder / "mine" / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / "mine" / name).write_text("mine")
    (folder / "link").symlink_to("nowhere")
    for file in ("stairs_test.txt", "estimates/stairs_hloc.txt"):
        (folder / "real" / "7scenes_stairs" / file).parent.mkdir(parents=True, exist_ok=True)
        (folder / "real" / "7scenes_stairs" / file).write_text("mine")
    return folder


def test_the_state_of_a_training_replaces_no_file_of_another_kind(belongings, capsys):
    (belongings / "new.training.safetensors").write_text("mine")
    before = contents(belongings)
    refuse([*OUTPUTS["train"], "new.safetensors"], capsys, "new.training.safetensors", "--overwrite")
    assert contents(belongings) == before


@pytest.mark.parametrize("name", OUTPUTS)
def test_no_command_replaces_what_no_command_wrote(name, belongings, capsys):
    before = contents(belongings)
    for output in ["mine/notes.txt", "mine/photo.png", "mine/report.json"] if name in FILES else ["mine"]:
        refuse([*OUTPUTS[name], output], capsys, "mine", "--overwrite")
    refuse([*OUTPUTS[name], "link"], capsys, "link: is a link to nowhere, which does not exist")
    for empty in ("", " "):
        with pytest.raises(SystemExit) as stopped:
            main([*OUTPUTS[name], empty])
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


def test_a_file_that_is_read_is_not_written_to(belongings, capsys):
    before = contents(belongings)
    words = {"calibrate": "m.safetensors", "posterior": "walk.mcap"}
    for name, output in words.items():
        refuse([*OUTPUTS[name], output, "--overwrite"], capsys, f"{output}: is read")
    refuse([*OUTPUTS["train"], "m.safetensors", "--initial-model", "m.safetensors"], capsys, "m.safetensors: is read")
    truth = belongings / "own" / "ground_truth.tum"
    truth.parent.mkdir()
    write_tum(truth, Trajectory(np.array([0, 10**9]), Poses.identity(2)))
    words = [*OUTPUTS["run"], "own", "--poses", str(truth), "--overwrite"]
    refuse(words, capsys, "ground_truth.tum: is read, and would be written to")
    assert contents(belongings).items() >= before.items()


IMAGE, POSE = "data/seq-01/frame-000003.color.png", "data/seq-01/frame-000003.pose.txt"
READ = {
    "train": (["train", "walk.mcap@0:9", "--output"], ["walk.mcap"]),
    "validation": (["train", "walk.mcap", "--validation", "notes.txt", "--output"], ["notes.txt"]),
    "weights": (
        ["train", "walk.mcap", "--pretrained-weights", "m.training.safetensors", "--output"],
        ["m.training.safetensors", "m.safetensors"],  # beside which the state of the training lies
    ),
    "poses": (["train", "walk.mcap", "--poses", "truth.tum", "--output"], ["truth.tum", "times.txt"]),
    "data set": (["train", "data", "--output"], [IMAGE, POSE]),
    "list": (["train", "data/TrainSplit.txt", "--output"], ["data/TrainSplit.txt", IMAGE]),
    "camera": (["train", "data/seq-01", "--output"], ["data/intrinsics.json"]),
    "images elsewhere": (["train", "colmap/sparse/0", "--output"], ["colmap/images/a/frame9.png"]),
    "calibrate": (["calibrate", "m.safetensors", "walk.mcap", "--output"], ["m.safetensors", "walk.mcap"]),
    "training": (["calibrate", "m.safetensors", "gone.mcap", "--training", "data", "--output"], [IMAGE]),
    "calibrate's poses": (["calibrate", "m.safetensors", "d", "--poses", "truth.tum", "--output"], ["truth.tum"]),
    "convert": (["convert", "data"], [IMAGE, POSE]),
    "odometry": (["convert", "data", "--odometry", "truth.tum"], ["truth.tum"]),
    "posterior": (["posterior", "data", "--model", "m.safetensors", "--output"], ["m.safetensors", IMAGE]),
    "evaluate": (["evaluate", "earlier", "--output"], ["earlier/trajectory.tum", "earlier/manifest.json"]),
    "evaluate's truth": (["evaluate", "mine", "--output"], ["mine/ground_truth.tum"]),
    "other truth": (["evaluate", "earlier", "--ground-truth", "truth.tum", "--output"], ["truth.tum"]),
    "run": (["run", "walk.mcap", "--model", "config.json", "--output"], ["."]),
    "run's poses": ([*OUTPUTS["run"][:-1], "--poses", "mine/ground_truth.tum", "--output"], ["mine"]),
    "a fleet": (["run", "walk.mcap", "walk/estimate.mcap", "--model", "m.safetensors", "--output"], ["."]),
    "fuse": (["fuse", "trajectory.tum", "--simulate-odometry", "truth.tum", "--output"], ["."]),
    "inspect": (["inspect", "data", "--output"], ["data", "data/seq-01"]),
    "inspect's model": (["inspect", "data", "--model", "report.json", "--output"], ["."]),
    "inspect's poses": (["inspect", "walk.mcap", "--poses", "map.png", "--output"], ["."]),
    "benchmark": (OUTPUTS["benchmark"], ["."]),
    "faults": (OUTPUTS["faults"], ["."]),
    "recorded faults": (OUTPUTS["recorded faults"], ["."]),
    "real": (["benchmark", "real", "--data", "real", "--output"], [".", "real/7scenes_stairs"]),
    "alpha": ([*OUTPUTS["alpha"][:-1], "--train.initial-model", "m.safetensors", "--output"], ["."]),
    "decay": ([*OUTPUTS["decay"][:-1], "--train.pretrained-weights", "m.safetensors", "--output"], ["."]),
    "schedule": ([*OUTPUTS["schedule"][:-1], "--train.initial-model", "m.safetensors", "--output"], ["."]),
    "table": (["experiment", "table", "own=data=walk.mcap", "--output"], [".", "data/seq-01"]),
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
    refuse(
        words, capsys, "own: holds config.json, ground_truth.tum, walk.mcap (which is read), expected", "--overwrite"
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
    assert main(words_of_run(walk_of_25, tiny_model, earlier)) == 130
    assert capsys.readouterr().err == "vapor-track run: interrupted\n"
    assert contents(earlier) == before


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (MemoryError(), "not enough memory"),
        (torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 20 GiB"), "not enough memory"),
        (
            RuntimeError("DefaultCPUAllocator: can't allocate memory: you tried to allocate 9 bytes"),
            "not enough memory",
        ),
        (BrokenProcessPool("A child process terminated abruptly"), "a worker process ended unexpectedly"),
    ],
)
def test_a_machine_that_is_too_small_is_told_in_one_line(error, said, tmp_path, monkeypatch, capsys):
    def fail(_: object) -> None:
        raise error

    monkeypatch.setattr("vapor.commands.evaluate.main", fail)
    refuse(["evaluate", str(tmp_path)], capsys, said)


def test_any_other_error_of_the_program_itself_is_not_hidden(tmp_path, monkeypatch):
    def fail(_: object) -> None:
        raise RuntimeError("mat1 and mat2 shapes cannot be multiplied")

    monkeypatch.setattr("vapor.commands.evaluate.main", fail)
    with pytest.raises(RuntimeError, match="mat1"):
        main(["evaluate", str(tmp_path)])


def test_a_missing_gpu_is_told(walk_of_25, tiny_model, tmp_path, capsys):
    if torch.cuda.is_available():
        pytest.skip("this machine has a CUDA device")
    words = [*words_of_run(walk_of_25, tiny_model, tmp_path / "out"), "--device", "cuda"]
    refuse(words, capsys, "no CUDA device", "expected --device cpu or auto")


# --- wrong arguments -----------------------------------------------------------------------------------


def status_of(words: list[str]) -> object:
    """Status of the process that these words would end, however that comes about."""
    try:
        return main(words)
    except SystemExit as end:
        return end.code


WRONG = {
    "no command": ([], ""),
    "unknown command": (["localise"], "unknown command 'localise', expected one of run, demo"),
    "unknown option": (["run", "a.mcap", "--model", "m", "--output", "o", "--nonsense", "1"], "nonsense"),
    "misspelt option": (
        ["run", "a.mcap", "--model", "m", "--output", "o", "--localizer.max-hypthoses", "9"],
        "hypthoses",
    ),
    "missing model": (["run", "a.mcap", "--output", "o"], "--model"),
    "missing sequence": (["run", "--model", "m", "--output", "o"], "MCAP file or rosbag2"),
    "value that is no number": (["run", "a.mcap", "--model", "m", "--output", "o", "--seed", "one"], "one"),
    "no hypotheses": (
        ["run", "a.mcap", "--model", "m", "--output", "o", "--localizer.max-hypotheses", "0"],
        "max_hypotheses is 0",
    ),
    "no samples": (["run", "a.mcap", "--model", "m", "--output", "o", "--num-samples", "0"], "num_samples is 0"),
    "negative seed": (["run", "a.mcap", "--model", "m", "--output", "o", "--seed", "-1"], "seed is -1"),
    "no threads": (["run", "a.mcap", "--model", "m", "--output", "o", "--threads", "0"], "threads is 0"),
    "setting out of range": (
        ["run", "a.mcap", "--model", "m", "--output", "o", "--localizer.modes.max-modes", "0"],
        "max_modes is 0, expected between 1",
    ),
    "setting of NaN": (["run", "a.mcap", "--model", "m", "--output", "o", "--duration-s", "nan"], "duration_s is nan"),
    "no odometry topic": (
        ["run", "a.mcap", "--model", "m", "--output", "o", "--odometry-topic", ""],
        "odometry_topic is '', expected the name of a topic",
    ),
    "no image topic": (["run", "a.mcap", "--model", "m", "--output", "o", "--image-topic", ""], "image_topic is ''"),
    "extrinsics without a rotation": (
        ["run", "a.mcap", "--model", "m", "--output", "o", "--base-from-camera", *"1230000"],
        "--base-from-camera: ",
    ),
    "unknown scene": (["synthesize", "attic", "s.mcap"], "attic"),
    "building without a number": (["synthesize", "building", "s.mcap"], "such as building-7"),
    "benchmark of an unknown scene": (
        ["benchmark", "localization", "building-x", "--output", "o"],
        "unknown scene 'building-x', expected one of staircase, ceiling, corridor, building-N",
    ),
    "benchmark of a table": (
        ["benchmark", "localization", "round-table", "--output", "o"],
        "unknown scene 'round-table'",
    ),
    "unknown cues": (["synthesize", "ceiling", "s.mcap", "--cues", "some"], "some"),
    "no such rate": (["synthesize", "staircase", "s.mcap", "--rate", "0"], "0 images a second"),
    "no frames": (["synthesize", "staircase", "s.mcap", "--frames", "0"], "0 frames"),
    "negative seed of a scene": (["synthesize", "staircase", "s.mcap", "--seed", "-1"], "seed -1"),
    "demo of no frames": (["demo", "--frames", "0"], "0 frames"),
    "unknown preset": (["train", "a.mcap", "--output", "m.safetensors", "--preset", "fast"], "expected one of auto"),
    "preset without name": (["train", "a.mcap", "--output", "m.safetensors", "--preset"], "preset"),
    "no training data": (["train", "--output", "m.safetensors"], "no training data"),
    "no model to write": (["train", "a.mcap"], "--output"),
    "no epochs": (["train", "a.mcap", "--output", "m.safetensors", "--epochs", "0"], "epochs is 0"),
    "both odometries": (["convert", "d", "o.mcap", "--odometry", "a.tum", "--odometry-noise"], "exclude each other"),
    "noise of no odometry": (["convert", "d", "o.mcap", "--noise.scale", "0.1"], "expected --odometry-noise with them"),
    "malformed frames": (["convert", "d", "o.mcap", "--frames", "1-9"], "expected START:STOP"),
    "no directory": (["evaluate"], "What `vapor-track run` wrote"),
    "no workers": (["benchmark", "localization", "ceiling", "--output", "o", "--workers", "0"], "workers is 0"),
    "no runs": (["benchmark", "localization", "ceiling", "--output", "o", "--runs", "-1"], "runs is -1"),
    "no frames of a benchmark": (
        ["benchmark", "localization", "ceiling", "--output", "o", "--frames", "49"],
        "frames is 49, expected at least 50",
    ),
    "no scene": (["benchmark", "localization", "--output", "o"], "expected each at most once, and one"),
    "a scene twice": (["benchmark", "localization", *["ceiling"] * 2, "--output", "o"], "scenes are ceiling, ceiling"),
    "unknown ablation": (
        ["benchmark", "localization", "ceiling", "--output", "o", "--ablations", "best"],
        "unknown ablation 'best', expected one of full,",
    ),
    "no kinds": (["benchmark", "localization", "ceiling", "--output", "o", "--kinds"], "kinds are none"),
    "more models than scenes": (
        ["benchmark", "localization", "ceiling", "--output", "o", "--models", "a", "b"],
        "2 models for 1 scenes, expected one for each",
    ),
    "no repetitions": (["benchmark", "step", "--repetitions", "0"], "repetitions is 0"),
    "a filter of no hypotheses": (["benchmark", "step", "--hypotheses", "10", "0"], "hypotheses are (10, 0)"),
    "a network of no preset": (
        ["benchmark", "step", "--preset", "fast"],
        "unknown preset 'fast', expected one of auto",
    ),
    "unknown benchmark": (["benchmark", "everything"], "expected one of step, localization"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_arguments_end_with_2_and_say_what_is_wrong(case, tmp_path, monkeypatch, capsys):
    words, said = WRONG[case]
    monkeypatch.chdir(tmp_path)
    assert status_of(words) == 2
    out, err = capsys.readouterr()
    assert said in err
    assert "Traceback" not in out + err
    assert list(tmp_path.iterdir()) == []


def test_the_overview_lists_every_command(capsys):
    assert main(["--help"]) == 0
    out = capsys.readouterr().out
    assert all(f"  {name} " in out for name in COMMANDS)
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("vapor-track 0.")


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_its_options(command, capsys):
    assert status_of([command, "--help"]) == 0
    out, err = capsys.readouterr()
    assert f"usage: vapor-track {command}" in out
    assert err == ""


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("run", "SEQUENCE"),
        ("convert", "DATASET OUT.mcap"),
        ("synthesize", "OUT.mcap"),
        ("evaluate", "DIRECTORY"),
        ("train", "DATA ..."),
    ],
)
def test_the_usage_names_what_to_give(command, said, capsys):
    assert status_of([command, "--help"]) == 0
    assert f" {said}" in capsys.readouterr().out.splitlines()[0]


def test_the_network_of_a_preset_is_timed_without_a_model_and_without_the_filter(capsys):
    assert main(["benchmark", "step", "--preset", "demo", "--repetitions", "1", "--num-samples", "10"]) == 0
    out = capsys.readouterr().out
    assert "network, 10 samples" in out
    assert "filter" not in out


def test_the_filter_is_timed_at_every_size_asked_for(tiny_model, capsys):
    words = ["benchmark", "step", "--model", str(tiny_model), "--repetitions", "1", "--num-samples", "10"]
    assert main([*words, "--hypotheses", "7", "20"]) == 0
    out = capsys.readouterr().out
    assert "filter, 7 hypotheses at most" in out
    assert "filter, 20 hypotheses at most" in out


def test_the_help_of_train_lists_the_presets(capsys):
    assert status_of(["train", "--help"]) == 0
    out = "".join(capsys.readouterr().out.replace("│", "").split())
    assert f"--preset{{{','.join(PRESETS)}}}" in out


# --- the process itself --------------------------------------------------------------------------------


def process(words: list[str], folder: Path, *python: str) -> subprocess.CompletedProcess[str]:
    path = os.pathsep.join([str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH", "")])
    environment = {**os.environ, "PYTHONPATH": path, "PYTHONHASHSEED": "77"}
    command = [sys.executable, *python, *words]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=120)


def test_help_and_version_load_no_network_library(tmp_path):
    for word in ("--help", "--version"):
        done = process(["-m", "vapor.track", word], tmp_path, "-X", "importtime")
        assert done.returncode == 0
        loaded = {line.rsplit("|")[-1].strip() for line in done.stderr.splitlines()}
        assert "filtering.errors" in loaded  # importtime is read rightly
        assert not {"torch", "rerun", "cv2", "gtsam", "matplotlib"} & loaded


@pytest.mark.usefixtures("unchecked", "no_pictures")
def test_the_process_ends_with_the_status_of_the_command_and_gives_the_same_bytes(walk_of_25, tiny_model, tmp_path):
    wrong = process(["-m", "vapor.track", "localise"], tmp_path)
    assert (wrong.returncode, wrong.stdout) == (2, "")
    misspelt = process(["-m", "vapor.track", "synthesize", "staircase", "s.mcap", "--fraems", "3"], tmp_path)
    assert misspelt.returncode == 2
    some = ["--duration-s", "0.5"]
    words = [*words_of_run(walk_of_25, tiny_model, tmp_path / "process"), *some]
    done = process(["-m", "vapor.track", *words], tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert "particle filter" in done.stdout
    assert main([*words_of_run(walk_of_25, tiny_model, tmp_path / "here"), *some]) == 0
    for name in ("trajectory.tum", "smoothed.tum", "estimate.mcap"):
        assert (tmp_path / "process" / name).read_bytes() == (tmp_path / "here" / name).read_bytes()


# --- the other commands ----------------------------------------------------------------------------------


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


def test_a_conversion_of_nothing_is_refused(tmp_path, capsys):
    words = ["convert", str(tmp_path / "data"), str(tmp_path / "o.mcap")]
    refuse(words, capsys, "data: no such folder", "transforms.json")
    make_tum(tmp_path / "data")
    write_tum(tmp_path / "day.tum", Trajectory(np.array([10**9, 2 * 10**9]), Poses.identity(2)))
    refuse([*words, "--odometry", str(tmp_path / "day.tum")], capsys, "day.tum", "covers no image")
    refuse([*words, "--frames", "50:60"], capsys, "no images in frames 50:60")
    assert not (tmp_path / "o.mcap").exists()


TRAINING = [
    *("--network.image-width", "32", "--network.image-height", "32", "--network.shortest-edge", "36"),
    *("--network.feature-dim", "32", "--network.latent-dim", "4", "--loss.num-samples", "32"),
    *(
        "--epochs",
        "2",
        "--batch-size",
        "8",
        "--validation-fraction",
        "0.2",
        "--precision",
        "float32",
        "--device",
        "cpu",
    ),
]


@pytest.mark.usefixtures("unchecked", "plain_results")
def test_a_training_that_was_interrupted_goes_on_and_its_model_runs(walk_of_25, tmp_path, capsys, monkeypatch):
    model = tmp_path / "model.safetensors"
    words = ["train", str(walk_of_25), "--output", str(model), *TRAINING]
    epochs = []

    def interrupted(state, *rest, original=trainer_module.train_epoch, **more):
        epochs.append(state.epoch)
        if epochs == [0, 1]:
            raise KeyboardInterrupt
        return original(state, *rest, **more)

    monkeypatch.setattr(trainer_module, "train_epoch", interrupted)
    assert main(words) == 130
    assert capsys.readouterr().err.splitlines()[-1].startswith("vapor-track train: interrupted")
    assert not model.exists()
    assert main(words) == 0
    assert epochs == [0, 1, 1]  # the first epoch is not done again
    assert "nothing is held out" in capsys.readouterr().err
    assert {path.name for path in tmp_path.iterdir()} == {"model.safetensors"}

    assert skipped_in_run(walk_of_25, model, tmp_path / "out") == (25, {})


def test_a_model_file_can_be_read_by_others_than_its_owner(tiny_model, tmp_path):
    (tmp_path / "any").write_bytes(b"")
    assert tiny_model.stat().st_mode == (tmp_path / "any").stat().st_mode


@pytest.mark.parametrize(
    ("data", "output", "said"),
    [
        ("absent.mcap", "m.safetensors", ["absent.mcap", "no such f"]),
        ("blind.mcap", "m.safetensors", ["blind.mcap", "no true poses found", "--ground-truth-topic /odom"]),
        ("walk.mcap", "folder/m.safetensors", ["m.safetensors: cannot be written", "expected the folder"]),
        ("walk.mcap", "taken", ["taken: is a folder, expected the name of a model file"]),
    ],
)
def test_a_training_that_cannot_be_is_refused(data, output, said, walk_of_25, tmp_path, capsys):
    (tmp_path / "walk.mcap").symlink_to(walk_of_25)
    (tmp_path / "taken").mkdir()
    rewrite(walk_of_25, tmp_path / "blind.mcap", keep=lambda topic, _: topic != TRUTH)
    refuse(["train", str(tmp_path / data), "--output", str(tmp_path / output), *TRAINING], capsys, *said)
    assert {path.name for path in tmp_path.iterdir()} == {"walk.mcap", "taken", "blind.mcap"}


def test_frames_of_training_data_that_are_no_numbers_are_told(tmp_path, capsys):
    words = ["train", f"{tmp_path}/walk.mcap@a:b", "--output", str(tmp_path / "m.safetensors")]
    refuse(words, capsys, "walk.mcap@a:b", "expected START:STOP after @ to be whole numbers")


def test_a_conversion_of_a_file_says_that_a_folder_was_expected(walk_of_25, tmp_path, capsys):
    refuse(
        ["convert", str(walk_of_25), str(tmp_path / "o.mcap")], capsys, walk_of_25, "is a file, expected the folder of"
    )
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("unchecked", "plain_results")
def test_a_synthetic_sequence_appears_and_can_be_run(tiny_model, tmp_path, capsys):
    output = tmp_path / "ceiling.mcap"
    words = ["synthesize", "ceiling", str(output), "--frames", "8", "--width", "80", "--height", "60", "--seed", "5"]
    assert main(words) == 0
    out, err = capsys.readouterr()
    assert f"{output}: 8 images" in out
    assert err == ""
    assert {path.name for path in tmp_path.iterdir()} == {"ceiling.mcap"}
    assert skipped_in_run(output, tiny_model, tmp_path / "out") == (8, {})


def test_a_synthetic_sequence_can_have_thirty_images_a_second(tmp_path, capsys):
    output = tmp_path / "ceiling.mcap"
    words = ["--frames", "7", "--rate", "30", "--width", "16", "--height", "16"]
    assert main(["synthesize", "ceiling", str(output), *words]) == 0
    assert "7 images" in capsys.readouterr().out
    times_ns = [frame.time_ns for frame in SequenceReader(output)]
    assert times_ns[6] - times_ns[0] == 200_000_000


def test_a_folder_that_cannot_be_written_to_is_named(tmp_path, capsys):
    (tmp_path / "file").write_text("mine")
    words = ["--frames", "2", "--width", "16", "--height", "16"]
    for folder in ("absent", "file"):
        output = tmp_path / folder / "s.mcap"
        refuse(["synthesize", "round-table", str(output), *words], capsys, output, "expected the folder")
    refuse(["synthesize", "round-table", str(tmp_path), *words], capsys, tmp_path, "cannot write: Is a directory")
    assert contents(tmp_path) == {"file": b"mine"}


def test_a_test_path_is_found_even_where_no_path_can_be_as_wished(monkeypatch):
    tried = []
    monkeypatch.setattr(choose, "resolvable", lambda seen: tried.append(len(seen)))  # never
    sequence = synthesize("ceiling", seed=0, num_frames=20, width=16, height=12)
    assert len(sequence.world_from_camera) == 20
    assert 10 < len(tried) <= 100


@pytest.mark.parametrize("words", [["nowhere"], ["empty"], ["run", "--ground-truth", "nowhere.tum"], ["run"]])
def test_an_evaluation_of_nothing_is_refused(words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "trajectory.tum").write_text("1.0 0 0 0 0 0 0 1\n")
    (tmp_path / "run" / "ground_truth.tum").write_text("1.0 0 0 nan 0 0 0 1\n")
    refuse(["evaluate", *words], capsys, "expected")


def test_a_demo_into_a_file_is_refused(tmp_path, capsys):
    (tmp_path / "file").write_text("mine")
    refuse(["demo", "--output", str(tmp_path / "file")], capsys, tmp_path / "file")


@pytest.mark.usefixtures("rough_light")
@pytest.mark.parametrize("scene", ["staircase", "ceiling"])
def test_the_demo_runs_with_the_model_that_ships(scene, tmp_path, monkeypatch, capsys):
    assert (shipped_models.SHIPPED / f"{scene}.safetensors").is_file(), f"no model ships for {scene}"
    assert (shipped_models.SHIPPED / f"{scene}.safetensors").stat().st_size <= 8_000_000
    monkeypatch.chdir(tmp_path)
    assert main(["demo", scene, "--frames", "6"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    for words in ("single image", "dead reckoning", "particle filter", "recording.rrd", "particles.png"):
        assert words in out
    report = json.loads((tmp_path / "demo" / scene / "report.json").read_text())
    assert report["frames"] == 6
    assert report["single_image"]["median_translation_m"] < 30  # within the scene
