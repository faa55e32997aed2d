import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from filtering.localizer import LocalizerConfig
from filtering.motion import Odometry
from filtering.se3 import Poses
from sequences.frame import Frame
from tests.sequence_files import Walk, rewrite
from tests.simulation import climb
from tests.test_datasets import make_7scenes
from vapor import calibrate as calibrate_module
from vapor.calibrate import calibrate
from vapor.checkpoint import Calibration, load_checkpoint, read_safetensors
from vapor.image_fit import fit_images
from vapor.loss import LossConfig
from vapor.network import NetworkConfig, SceneBox, VariationalPoseRegressor
from vapor.stretches import (
    GRIDS,
    SAFE_PREFERENCE,
    Scores,
    Stretch,
    belief_scores,
    choose,
    choose_detail,
    find_stretches,
    simulated_odometry,
)
from vapor.track import main
from vapor.train import train_on
from vapor.train_config import TrainConfig
from vapor.training_set import load_training_set

# --- image by image --------------------------------------------------------------------------------


def oracle(count, spread_m, spread_rad, outliers, *, rng, num_samples=200):
    """True poses in a hall of 10 x 10 x 2 m, and samples that are `spread` around them; for outliers, anywhere."""
    std = np.array([spread_m] * 3 + [spread_rad] * 3)

    def anywhere(n):
        tangents = rng.uniform(-1, 1, (n, 6)) * [0, 0, 0, 0.8, 0.8, 0.8]
        return Poses(Poses.exp(tangents).rotation, rng.uniform([-5, -5, -1], [5, 5, 1], (n, 3)))

    truth = anywhere(count)
    centres = [truth[[i]] if rng.random() > outliers else anywhere(1) for i in range(count)]
    # As of a calibrated posterior: the truth lies in the samples as any other draw would.
    samples = [
        c[0] @ Poses.exp(rng.standard_normal(6) * std) @ Poses.exp(rng.standard_normal((num_samples, 6)) * std)
        for c in centres
    ]
    return samples, truth, anywhere(1000)


@pytest.mark.parametrize(("spread_m", "spread_rad", "outliers"), [(0.2, 0.05, 0.1), (0.05, 0.15, 0.3)])
def test_the_outlier_floor_and_the_scale_of_the_kernels_are_found_from_samples_of_known_spread(
    spread_m, spread_rad, outliers
):
    rng = np.random.default_rng(0)
    samples, truth, prior = oracle(300, spread_m, spread_rad, outliers, rng=rng)
    fitted, changes = fit_images(samples, truth, prior, Calibration())
    # Of 200 samples in six dimensions the best kernel is narrower than the posterior: Silverman's factor is 0.55.
    assert 0.35 * spread_m < fitted.bandwidth_translation_m < 0.9 * spread_m
    assert 0.35 * spread_rad < fitted.bandwidth_rotation_rad < 0.9 * spread_rad
    assert fitted.outlier_floor == pytest.approx(outliers, abs=0.06)  # three standard deviations of 300 draws
    assert {change.what for change in changes} == {"prior π", "kernel widths", "outlier floor ε"}
    assert all(change.gain >= -1e-4 for change in changes)


def test_kernels_of_a_single_sample_get_exactly_the_spread_of_its_error():
    rng = np.random.default_rng(1)
    std = np.array([0.1] * 3 + [0.04] * 3)
    _, truth, prior = oracle(500, 0.1, 0.04, 0.0, rng=rng, num_samples=1)
    samples = [truth[[i]] @ Poses.exp(rng.standard_normal((1, 6)) * std) for i in range(500)]
    fitted, _ = fit_images(samples, truth, prior, Calibration())
    assert fitted.bandwidth_translation_m == pytest.approx(0.1, rel=0.08)
    assert fitted.bandwidth_rotation_rad == pytest.approx(0.04, rel=0.08)


# --- on stretches ----------------------------------------------------------------------------------

STD = np.array([0.12] * 3 + [0.08] * 3)
FAR = np.array([0.0, 6.0, 0.0])
FEW = LocalizerConfig(num_particles=1000)
WIDTHS = Calibration(0.07, 0.045, outlier_floor=0.02)


def moved(poses, shift):
    return Poses(poses.rotation, poses.translation + shift)


def walks(samples_of, *, count=5, length=30, seed=0):
    """Stretches of a climb; `samples_of(pose, stretch, rng)` are an image's samples."""
    rng = np.random.default_rng(seed)
    stretches = []
    for k in range(count):
        truth, odometry = climb(length, rng=rng)
        stretches.append(Stretch([samples_of(truth[i], k, rng) for i in range(length)], odometry, truth))
    return stretches


def prior_of(stretches):
    truth = Poses.concatenate([stretch.truth for stretch in stretches])
    return Poses.concatenate([truth, moved(truth, FAR)])


def scores(stretches, calibration):
    likelihood = calibration.likelihood(prior_of(stretches))
    return belief_scores(stretches, calibration, likelihood, config=FEW, seed=0).log_density.mean()


@pytest.mark.parametrize("shared", [False, True])
def test_within_a_place_independent_images_count_fully_and_images_of_the_same_error_do_not(shared):
    error = [Poses.exp(e * STD) for e in np.random.default_rng(5).standard_normal((5, 6))]

    def samples_of(pose, k, rng):
        own = error[k] if shared else Poses.exp(rng.standard_normal(6) * STD)
        return pose @ own @ Poses.exp(rng.standard_normal((200, 6)) * STD)

    stretches = walks(samples_of)
    little, much = (scores(stretches, replace(WIDTHS, detail_temper=value)) for value in (0.1, 0.5))
    assert little > much + 1.0 if shared else much > little + 1.0


@pytest.mark.parametrize("shared", [False, True])
def test_between_places_independent_images_count_fully_and_images_of_the_same_error_do_not(shared):
    def samples_of(pose, k, rng):
        right = k % 2 == 0 if shared else rng.random() < 0.7
        samples = pose @ Poses.exp(rng.standard_normal((200, 6)) * STD)
        here = rng.random(200) < (0.7 if right else 0.3)
        return moved(samples, np.where(here[:, None], 0.0, FAR))

    stretches = walks(samples_of)
    unsaturated = replace(WIDTHS, saturation=1e6)
    little, much = (scores(stretches, replace(unsaturated, temper=value)) for value in (0.1, 1.0))
    assert little > much + 1.0 if shared else much > little + 0.5


def given(best, noise, *, on="temper"):
    """Scores of four stretches with a peak at `best`, and noise on the differences."""
    signs = np.array([1.0, -1.0, 1.0, -1.0])
    return lambda c: Scores(-10 * abs(getattr(c, on) - best) + noise * getattr(c, on) * signs, 0, 0)


def test_tempering_changes_no_further_than_it_gains_more_than_noise():
    sure, choice = choose("temper", Calibration(), given(0.4, 0.0))
    assert (sure.temper, choice.value, choice.preferred) == (0.4, 0.4, 0.4)
    assert choice.gain == pytest.approx(2.0)
    assert choice.error == pytest.approx(0.0, abs=1e-9)
    assert sure.preference == pytest.approx(SAFE_PREFERENCE / 0.4)  # lowered with it
    unsure, choice = choose("temper", Calibration(), given(0.4, 100.0))
    assert (unsure, choice.preferred) == (Calibration(), 0.4)
    lower, choice = choose("temper", Calibration(), given(0.1, 0.0))
    assert (lower.temper, choice.preferred) == (0.1, 0.1)
    unsure, choice = choose("temper", Calibration(), given(0.1, 100.0))
    assert (unsure, choice.preferred) == (Calibration(), 0.1)

    def clearly_more(c):
        return Scores(np.array([1.0, -1.0]) * (c.temper == 0.3) - 9.0 * (c.temper < 0.25) + 0.1 * c.temper, 0, 0)

    nearest, choice = choose("temper", Calibration(), clearly_more)
    assert (nearest.temper, choice.preferred) == (0.3, 0.4)


@pytest.mark.parametrize(("covering", "chosen"), [(0.3, 0.2), (10.0, 1.0), (0.05, 0.1)])
def test_the_detail_that_counts_is_as_much_as_leaves_the_regions_true(covering, chosen):
    def score(candidate):
        value = candidate.detail_temper
        return Scores(np.array([value, value]), 1000, 920 if value < covering and value != 0.15 else 880)

    detail, choice, coverage = choose_detail(Calibration(detail_temper=0.35), score)
    assert detail == Calibration(detail_temper=chosen)
    assert (choice.value, choice.preferred) == (chosen, 1.0)
    assert choice.gain == pytest.approx(chosen - 0.35)
    assert coverage == (0.92 if chosen < covering else 0.88)


def test_of_details_whose_regions_hold_enough_the_likeliest_is_taken():
    def score(candidate):
        return Scores(np.full(2, -abs(candidate.detail_temper - 0.2)), 1000, 950)

    detail, choice, coverage = choose_detail(Calibration(detail_temper=0.5), score)
    assert (detail.detail_temper, choice.preferred, coverage) == (0.2, 0.2, 0.95)


def test_without_images_in_the_right_place_the_detail_stays_as_it_was():
    detail, _, coverage = choose_detail(Calibration(detail_temper=0.3), given(0.2, 0.0, on="detail_temper"))
    assert (detail.detail_temper, coverage) == (0.3, None)


@pytest.mark.parametrize(("shared", "honest"), [(False, True), (True, False)])
def test_regions_hold_the_true_poses_unless_images_err_alike(shared, honest):
    error = [Poses.exp(e * STD) for e in np.random.default_rng(5).standard_normal((5, 6))]

    def samples_of(pose, k, rng):
        own = error[k] if shared else Poses.exp(rng.standard_normal(6) * STD)
        return pose @ own @ Poses.exp(rng.standard_normal((200, 6)) * STD)

    stretches = walks(samples_of)
    calibration = replace(WIDTHS, detail_temper=0.5)
    scores = belief_scores(stretches, calibration, calibration.likelihood(prior_of(stretches)), config=FEW, seed=0)
    assert scores.right == 150
    assert (scores.covered > 0.85 * 150) == honest


def test_a_preference_that_would_converge_wrongly_is_told_but_not_taken():
    calibration, choice = choose("preference", Calibration(temper=0.3), given(0.1, 0.0, on="preference"))
    assert choice.preferred == 0.1
    assert calibration.preference == choice.value == 0.06
    calibration, choice = choose("preference", Calibration(temper=0.2), given(0.1, 100.0, on="preference"))
    assert calibration.preference == choice.preferred == 0.1


# --- data ------------------------------------------------------------------------------------------

NETWORK = NetworkConfig(image_width=32, image_height=32, shortest_edge=36, feature_dim=16, latent_dim=4)


def frames_of(count, *, odometry=True, seed=0):
    rng = np.random.default_rng(seed)
    truth, increments = climb(count, rng=rng)
    images = rng.integers(0, 256, (count, 36, 36, 3), dtype=np.uint8)
    return [Frame(i * 10**8, images[i], increments[i] if odometry else None, truth[i]) for i in range(count)]


def network_for(images):
    torch.manual_seed(0)
    return VariationalPoseRegressor(NETWORK, SceneBox.around(images.poses)).eval()


def test_stretches_break_where_odometry_does_and_where_time_does():
    frames = frames_of(150)
    frames[60] = replace(frames[60], odometry=None)
    late = [
        replace(f, time_ns=f.time_ns + (10**9 if i >= 90 else 0)) for i, f in enumerate(frames_of(150, odometry=False))
    ]
    images = load_training_set({"a": frames, "b": late, "short": frames_of(30)}, (36, 36))
    spans = [(int(s[0]), int(s[-1]) + 1) for s in find_stretches(images, 500)]
    assert spans == [(0, 60), (60, 150), (150, 240), (240, 300)]
    assert len(find_stretches(images, 200)) == 3  # fewer could not tell a gain from noise
    thinned = images.select(np.arange(0, len(images), 2))
    assert all(odometry is None for odometry in thinned.odometry)
    assert images.select(np.arange(5, 9)).odometry == (None, *images.odometry[6:9])


def test_odometry_that_is_missing_is_simulated_with_the_noise_that_it_states():
    images = load_training_set({"a": frames_of(200, odometry=False)}, (36, 36))
    odometry = simulated_odometry(images, np.arange(200), rng=np.random.default_rng(0))
    assert odometry[0] is None
    squared = []
    for i in range(1, 200):
        increment = odometry[i]
        assert isinstance(increment, Odometry)
        error = (increment.previous_from_current.inverse() @ images.poses[i - 1].inverse() @ images.poses[i]).log()
        squared.append(error @ np.linalg.solve(increment.covariance, error))
    assert np.mean(squared) == pytest.approx(6.0, abs=0.75)  # three standard deviations of 199 χ² with six degrees


def test_too_few_images_keep_the_calibration_and_say_so():
    images = load_training_set({"a": frames_of(30)}, (36, 36))
    before = Calibration(temper=0.37)
    result = calibrate(network_for(images), images, images.poses, before, max_images=500, seed=0)
    assert result.calibration == before
    assert (result.images, result.changes) == (0, ())
    assert "30 held-out images, at least 50" in result.notes[0]


def test_without_stretches_only_the_fits_image_by_image_are_made():
    images = load_training_set({str(k): frames_of(30, seed=k) for k in range(3)}, (36, 36))
    result = calibrate(network_for(images), images, images.poses, Calibration(), max_images=500, seed=0)
    assert (result.images, result.stretches) == (90, 0)
    assert "0 held-out stretches, at least 3" in result.notes[0]
    assert result.calibration.bandwidth_translation_m != Calibration().bandwidth_translation_m
    kept = ("temper", "preference", "detail_temper", "saturation")
    assert all(getattr(result.calibration, name) == getattr(Calibration(), name) for name in kept)


def test_training_calibrates_at_its_end_and_stores_values_and_gains(tmp_path, monkeypatch):
    monkeypatch.setattr(calibrate_module, "NUM_SAMPLES", 100)
    for name in GRIDS:
        monkeypatch.setitem(GRIDS, name, ())  # the present value only: one run of the filter
    config = TrainConfig(NETWORK, LossConfig(num_samples=16), epochs=1, precision="float32", device="cpu")
    held_out = {str(k): frames_of(45, seed=k) for k in range(3)}
    stages = []
    result = train_on(
        {"a": frames_of(40)},
        tmp_path / "m.safetensors",
        config,
        validation=held_out,
        progress=lambda p: stages.append(p.stage),
    )
    calibrated = result.calibration
    assert (calibrated.images, calibrated.stretches, calibrated.odometry) == (135, 3, "recorded")
    assert "calibrating" in stages
    stored = load_checkpoint(tmp_path / "m.safetensors")
    assert stored.calibration == calibrated.calibration != Calibration()
    assert [change["what"] for change in stored.training["calibration"]["changes"]] == [
        *("prior π", "kernel widths", "outlier floor ε", "tempering β", "preference γ", "detail β_d")
    ]
    assert stored.training["calibration"] == json.loads(json.dumps(calibrated.provenance))
    off = replace(config, calibrate=False)
    without = train_on({"a": frames_of(40)}, tmp_path / "n.safetensors", off, validation=held_out)
    assert (without.calibration, without.checkpoint.calibration) == (None, Calibration())


# --- the command -----------------------------------------------------------------------------------


def test_the_command_writes_the_same_weights_with_another_calibration(tiny_model, tmp_path, capsys):
    walk, output = Walk(60).write(tmp_path / "walk.mcap"), tmp_path / "m.safetensors"
    assert main(["calibrate", str(tiny_model), str(walk), "--output", str(output), "--device", "cpu"]) == 0
    printed = capsys.readouterr().out
    assert "kernel widths" in printed
    assert "0 held-out stretches" not in printed
    assert "1 held-out stretches, at least 3" in printed
    before, after = load_checkpoint(tiny_model), load_checkpoint(output)
    assert after.calibration.bandwidth_translation_m != before.calibration.bandwidth_translation_m
    assert after.training["calibration"]["data"] == ["walk.mcap"]
    old, new = read_safetensors(tiny_model)[1], read_safetensors(output)[1]
    assert old.keys() == new.keys()
    assert all(old[name].dtype == new[name].dtype and torch.equal(old[name], new[name]) for name in old)


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
    [(60, False, "no image with a true pose"), (20, True, "20 images with true poses, expected at least 50")],
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
