"""`vapor-track train`: interrupted ones go on, and what cannot be is refused."""

import re

import pytest

from tests.helpers.command_line import refuse, skipped_in_run
from tests.helpers.data_sets import make_tum, write_image
from tests.helpers.sequence_files import TRUTH, Walk, rewrite
from vapor.track import main
from vapor.training import trainer as trainer_module

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


@pytest.mark.usefixtures("unchecked")
def test_what_is_said_of_a_training_is_for_its_user(walk_of_25, tmp_path, capsys):
    held_out = Walk(60).write(tmp_path / "other.mcap")
    words = ["train", str(walk_of_25), "--validation", str(held_out), "--output", str(tmp_path / "m.safetensors")]
    options = [word for word in TRAINING if word not in ("--epochs", "2")]
    assert main([*words, *options, "--hours", "1e-9", "--most-epochs", "1", "--no-landmarks"]) == 0
    out, err = capsys.readouterr()
    assert re.search(r"^1 epoch will take about \d+ s, by the time of some steps; then come", err, re.MULTILINE)
    assert "true poses in the 50, 90, 95 % regions of single images: " in out
    assert "on 25 held-out images, worth " in out  # of 60, the training images show the surroundings of these
    assert re.search(r"kept epoch 1; of 25 held-out images .* are within 0\.3 m and 20°; they are of the held", out)
    assert not any(word in out for word in ("nats", "log ratio", "correlated_fraction"))


def test_a_range_of_training_data_that_is_longer_than_they_are_is_said(tmp_path, capsys):
    data = make_tum(tmp_path / "desk", num_images=10)
    options = [*TRAINING, "--no-calibrate", "--no-landmarks", "--epochs", "1"]
    assert main(["train", f"{data}@4:900", "--output", str(tmp_path / "m.safetensors"), *options]) == 0
    said = "images 4:900 were asked for, and there are 10, numbered 0 to 9: 4 to 9 were taken"
    assert said in capsys.readouterr().out


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
        ("walk.mcap", "model.h5", ["model.h5: expected the name of a model file to write, which ends in .safetensors"]),
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
    refuse(words, capsys, "walk.mcap@a:b: @a:b is no part, expected @START:STOP, whole numbers")
    (tmp_path / "walk.mcap").touch()
    words[1] = f"{tmp_path}/walk.mcap@abc"
    refuse(words, capsys, "walk.mcap@abc: @abc is no part, expected @START:STOP")
    words[1] = f"{tmp_path}/walk.mcap@7:5"
    refuse(words, capsys, "walk.mcap@7:5: @7:5 has no image, expected START:STOP with STOP above START")


def test_frames_that_are_not_there_are_told_with_how_many_are(walk_of_25, tmp_path, capsys):
    for data in (make_tum(tmp_path / "data", num_images=8), walk_of_25):
        count = 8 if data.is_dir() else 25
        words = ["train", f"{data}@900:1000", "--output", str(tmp_path / "m.safetensors"), *TRAINING]
        said = f"no image with a true pose in frames 900:1000; there are {count}, numbered 0 to {count - 1}\n"
        refuse(words, capsys, said)


def test_images_of_a_data_set_are_told_to_be_its(tmp_path, capsys, monkeypatch):
    data = make_tum(tmp_path / "desk")
    words = ["train", str(data / "rgb"), "--output", str(tmp_path / "m.safetensors")]
    refuse(words, capsys, f"images of a data set, expected its folder, which has their true poses: {data}\n")
    monkeypatch.chdir(data)
    words[1] = "rgb"
    refuse(words, capsys, f"expected its folder, which has their true poses: {data}\n")


def test_a_command_in_a_message_can_be_copied_whatever_the_path(tmp_path, capsys):
    (images := tmp_path / ("a" * 100 + " " + "b" * 100)).mkdir()
    write_image(images / "0.png", 0)
    words = ["train", str(images), "--output", str(tmp_path / "m.safetensors")]
    refuse(words, capsys, f"(`vapor-track map '{images}' --output place/` makes them)")
