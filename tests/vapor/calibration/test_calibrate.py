"""Calibration of a network on held-out images: from data to a model file."""

import json
from dataclasses import asdict, replace
from shutil import copyfile

import numpy as np
import pytest
import torch

from filtering.measurement_noise import MeasurementNoise
from filtering.se3 import Poses
from sequences.datasets.listing import list_images
from tests.helpers.checkpoints import remembering
from tests.helpers.command_line import refuse
from tests.helpers.data_sets import make_7scenes
from tests.helpers.erring_posteriors import anywhere
from tests.helpers.full import full
from tests.helpers.sequence_files import Walk, rewrite
from tests.helpers.simulation import frames_of
from vapor.calibration import calibrate as calibrate_module
from vapor.calibration.calibrate import calibrate, fit_widths
from vapor.checkpoints.calibration import Calibration
from vapor.checkpoints.file_format import load_checkpoint
from vapor.checkpoints.scene_scale import default_errors
from vapor.regressors.loss_config import LossConfig
from vapor.regressors.network_config import NetworkConfig
from vapor.regressors.scene_box import SceneBox
from vapor.regressors.variational import VariationalPoseRegressor
from vapor.tensor_files import read_safetensors
from vapor.track import main
from vapor.training.config import TrainConfig
from vapor.training.train import train_on
from vapor.training_data.load import load_training_set

NETWORK = NetworkConfig(image_width=32, image_height=32, shortest_edge=36, feature_dim=16, latent_dim=4)


def network_for(images):
    torch.manual_seed(0)
    return VariationalPoseRegressor(NETWORK, SceneBox.around(images.poses)).eval()


FITS = ["kernel widths", "errors of an image", "how long they last"]


@pytest.fixture(autouse=True)
def few_samples(monkeypatch):
    monkeypatch.setattr(calibrate_module, "NUM_SAMPLES", 100)


def test_too_few_images_keep_the_calibration_and_say_so():
    images = load_training_set({"a": frames_of(19)}, (36, 36))
    before = Calibration(0.3, 0.2, MeasurementNoise(degrees_of_freedom=3.7))
    result = calibrate(network_for(images), images, images.poses, before, max_images=500, seed=0)
    assert result.calibration == before
    assert (result.images, result.changes, result.coverage) == (0, (), None)
    assert "19 held-out images, at least 20" in result.notes[0]


def test_errors_are_fitted_on_images_and_odometry_on_what_leads_between_them():
    images = load_training_set({str(k): frames_of(45, seed=k) for k in range(3)}, (36, 36))
    seen = []
    result = calibrate(
        network_for(images),
        images,
        images.poses,
        Calibration(),
        max_images=80,
        seed=0,
        advance=lambda done, total: seen.append((done, total)),
    )
    assert result.images == 80
    assert (seen[0], seen[-1]) == ((1, 80), (80, 80))
    assert 1.0 <= result.effective_images <= 80
    assert [change.what for change in result.changes] == FITS
    assert result.reliability is not None
    assert sum(each.images for each in result.reliability.bins) == 80
    assert result.coverage is not None
    assert 0.0 <= result.coverage[0] <= result.coverage[1] <= result.coverage[2] <= 1.0
    noise = result.calibration.errors
    assert noise != MeasurementNoise()
    # A network of random weights is anywhere in the scene: what it says is worth little.
    extent = np.ptp(images.poses.translation, axis=0)
    assert max(noise.typical_std[:3]) > 0.1 * extent.max()
    odometry = result.calibration.odometry
    assert odometry is not None
    assert (result.odometry, odometry.increments, odometry.recordings) == ("held-out data", 132, 3)


@full
@pytest.mark.usefixtures("unchecked", "widest_places")
def test_without_odometry_in_held_out_data_that_of_the_training_data_is_taken():
    bare = load_training_set({"a": frames_of(60, odometry=False)}, (36, 36))
    network, before = network_for(bare), Calibration(errors=default_errors(bare.poses))
    none = calibrate(network, bare, bare.poses, before, max_images=60, seed=0)
    assert (none.odometry, none.calibration.odometry) == ("none", None)
    training = load_training_set({"b": frames_of(120)}, (36, 36))
    result = calibrate(network, bare, bare.poses, before, training=training, max_images=60, seed=0)
    assert result.odometry == "training data"
    assert result.calibration.odometry is not None
    assert result.calibration.errors == none.calibration.errors
    kept = calibrate(network, bare, bare.poses, result.calibration, max_images=60, seed=0)
    assert (kept.odometry, kept.calibration.odometry) == ("none", result.calibration.odometry)


@pytest.mark.usefixtures("widest_places")
def test_twenty_images_are_enough():
    images = load_training_set({"a": frames_of(20)}, (36, 36))
    result = calibrate(network_for(images), images, images.poses, Calibration(), max_images=500, seed=0)
    assert (result.images, result.notes) == (20, ())
    noise = result.calibration.errors
    assert noise.constant_fraction == pytest.approx(0.1 + 2.0 / result.effective_images)


@pytest.mark.usefixtures("unchecked")
def test_training_calibrates_at_its_end_and_stores_values_and_gains(tmp_path, monkeypatch):
    monkeypatch.setattr("vapor.training.check._WIDER", (2.0,))
    config = TrainConfig(network=NETWORK, loss=LossConfig(num_samples=16), epochs=1, precision="float32", device="cpu")
    held_out = {str(k): frames_of(30, seed=k) for k in range(2)}
    stages = []
    result = train_on(
        {"a": frames_of(45)},
        tmp_path / "m.safetensors",
        config,
        validation=held_out,
        progress=lambda p: stages.append(p.stage),
    )
    calibrated = result.calibration
    assert calibrated is not None
    assert (calibrated.images, calibrated.odometry) == (60, "none")
    assert list(dict.fromkeys(stages)) == ["reading", "holding out", "training", "calibrating", "checking"]
    stored = load_checkpoint(tmp_path / "m.safetensors")
    assert result.check is not None
    assert stored.training["check"] == json.loads(json.dumps(asdict(result.check)))
    assert stored.training["check"]["images"] == 60
    if result.check.inflation == 1.0 and not result.check.assumed:
        assert stored.calibration == calibrated.calibration
    told = [change["what"] for change in stored.training["calibration"]["changes"]]
    assert told == FITS
    assert stored.training["calibration"] == json.loads(json.dumps(calibrated.provenance))
    off = replace(config, calibrate=False, bandwidth_translation_m=0.3)
    without = train_on({"a": frames_of(45)}, tmp_path / "n.safetensors", off, validation=held_out)
    assert without.calibration is None
    assert without.checkpoint.calibration == Calibration(0.3, 0.1, default_errors(without.checkpoint.prior_poses))


# --- the command -----------------------------------------------------------------------------------


@pytest.mark.usefixtures("widest_places", "knowing")
def test_the_command_writes_the_same_weights_with_another_calibration(tiny_model, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    walk, output = Walk(60).write(tmp_path / "walk.mcap"), tmp_path / "m.safetensors"
    assert main(["calibrate", str(tiny_model), str(walk), "--output", str(output), "--device", "cpu"]) == 0
    printed = capsys.readouterr().out
    assert "60 held-out images" in printed
    assert "correlated_fraction" in printed
    assert "trust in the weights of places (1: " in printed
    assert "expected calibration error" in printed
    assert max(len(line) for line in printed.splitlines() if set("│┃") & set(line)) <= 80
    assert "true poses in the 50, 90, 95 % regions of single images" in printed
    before, after = load_checkpoint(tiny_model), load_checkpoint(output)
    assert after.calibration.bandwidth_translation_m != before.calibration.bandwidth_translation_m
    assert after.calibration.errors != before.calibration.errors
    assert after.training["calibration"]["data"] == ["walk.mcap"]
    old, new = read_safetensors(tiny_model)[1], read_safetensors(output)[1]
    assert old.keys() == new.keys()
    assert all(old[name].dtype == new[name].dtype and torch.equal(old[name], new[name]) for name in old)


@pytest.mark.usefixtures("widest_places", "knowing")
def test_the_command_tells_what_it_left_out_of_the_data(tiny_model, tmp_path, capsys):
    names = ("seq-01", "seq-02", "seq-03")
    scene = make_7scenes(tmp_path / "chess", num_images=20, sequences=names)
    (scene / "seq-01" / "frame-000003.pose.txt").unlink()
    (scene / "seq-03" / "frame-000009.color.png").write_bytes(b"no image")
    data, output = [str(scene / name) for name in names], tmp_path / "m.safetensors"
    assert main(["calibrate", str(tiny_model), *data, "--output", str(output), "--device", "cpu"]) == 0
    printed = capsys.readouterr().out
    assert "skipped 1: no true pose" in printed
    assert "skipped 1: undecodable image" in printed
    assert "skipped" not in json.dumps(load_checkpoint(output).training)


@pytest.mark.parametrize(
    ("num_images", "posed", "said"),
    [(60, False, "no true poses found"), (19, True, "19 images with true poses, expected at least 20")],
)
def test_the_command_refuses_data_without_poses_or_too_little(num_images, posed, said, tiny_model, tmp_path, capsys):
    whole = Walk(num_images).write(tmp_path / "whole.mcap")
    data, output = tmp_path / "walk.mcap", tmp_path / "m.safetensors"
    rewrite(whole, data, keep=lambda topic, _: posed or topic != "/ground_truth/pose")
    assert main(["calibrate", str(tiny_model), str(data), "--output", str(output)]) == 1
    error = capsys.readouterr().err
    assert "walk.mcap" in error
    assert said in error
    assert not output.exists()


def test_the_output_is_named_as_a_model(tiny_model, tmp_path, capsys):
    words = ["calibrate", str(tiny_model), "walk.mcap", "--output", str(tmp_path / "model.onnx")]
    refuse(words, capsys, "model.onnx: expected the name of a model file to write, which ends in .safetensors")


@pytest.mark.usefixtures("widest_places")
@pytest.mark.parametrize("is_new", [True, False])
def test_images_of_another_place_are_refused_and_the_output_stays_as_it_was(is_new, tiny_model, tmp_path, capsys):
    walk, output = Walk(24).write(tmp_path / "walk.mcap"), tmp_path / "m.safetensors"
    if not is_new:
        copyfile(tiny_model, output)
    refuse(
        ["calibrate", str(tiny_model), str(walk), "--output", str(output), "--device", "cpu"],
        capsys,
        "walk.mcap: the best place of a single image is the true one in 0 % of 24 images, expected at least 2 %",
        "of another place",
    )
    assert output.exists() is not is_new
    assert is_new or output.read_bytes() == tiny_model.read_bytes()


@pytest.mark.usefixtures("widest_places", "knowing")
def test_images_that_most_were_trained_on_are_refused_and_some_are_said(tmp_path, capsys):
    scene = make_7scenes(tmp_path / "scene", num_images=40)
    model = remembering(list_images(scene).world_from_camera[:20], tmp_path / "model.safetensors")
    output = tmp_path / "m.safetensors"
    words = ["--output", str(output), "--device", "cpu"]
    for more in ([], ["--ood-only"]):
        said = "scene@:30: the model was trained on 20 of the 30 images, by their true poses"
        refuse(["calibrate", str(model), f"{scene}@:30", *words, *more], capsys, said)
        assert not output.exists()
    assert main(["calibrate", str(model), str(scene), *words]) == 0
    assert "20 of 40 images were trained on" in capsys.readouterr().out
    assert main(["calibrate", str(model), f"{scene}@20:", *words]) == 0
    assert "were trained on" not in capsys.readouterr().out


# --- kernel widths ---------------------------------------------------------------------------------


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(("spread_m", "spread_rad"), [(0.2, 0.05), (0.05, 0.15)])
def test_the_scale_of_the_kernels_is_found_from_samples_of_known_spread(spread_m, spread_rad):
    rng = np.random.default_rng(0)
    std = np.repeat([spread_m, spread_rad], 3)
    truth = anywhere(300, rng=rng)
    # As of a calibrated posterior: the truth lies in the samples as any other draw would.
    centres = truth @ Poses.exp(rng.standard_normal((300, 6)) * std)
    samples = [centres[i] @ Poses.exp(rng.standard_normal((200, 6)) * std) for i in range(300)]
    (width_m, width_rad), change = fit_widths(samples, truth, truth, (0.1, 0.1))
    # Of 200 samples in six dimensions the best kernel is narrower than the posterior: Silverman's factor is 0.55.
    assert 0.35 * spread_m < width_m < 0.9 * spread_m
    assert 0.35 * spread_rad < width_rad < 0.9 * spread_rad
    assert change.after == {"bandwidth_translation_m": width_m, "bandwidth_rotation_rad": width_rad}
    assert change.gain is not None
    assert change.gain >= -1e-4
