import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from filtering.measurement_noise import MeasurementNoise
from filtering.se3 import Poses
from sequences.frame import Camera
from sequences.odometry_fit.result import OdometryFit
from tests.helpers.checkpoints import SMALL, make_checkpoint
from vapor.checkpoints import file_format
from vapor.checkpoints.file_format import find_model, load_checkpoint, load_description, save_checkpoint
from vapor.checkpoints.scene_scale import default_errors, spaced
from vapor.landmarks.landmark_map import LandmarkMap, ViewCamera
from vapor.landmarks.verify import Landmarks, Verification
from vapor.regressors.network_config import NetworkConfig
from vapor.tensor_files import CheckpointError, read_safetensors, write_safetensors

SIX = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
ODOMETRY = OdometryFit(SIX, (0.0,) * 6, SIX, 30.0, -0.01, 0.02, SIX, SIX, SIX, 0.1, 500, 2, 50.0, 40.0, 3)


def test_a_model_file_gives_back_exactly_what_was_saved(tmp_path):
    saved = make_checkpoint()
    save_checkpoint(tmp_path / "m.safetensors", saved)
    loaded = load_checkpoint(tmp_path / "m.safetensors")
    assert (loaded.network, loaded.box, loaded.calibration) == (saved.network, saved.box, saved.calibration)
    assert loaded.training == saved.training
    np.testing.assert_array_equal(loaded.prior_poses.as_matrix(), saved.prior_poses.as_matrix())
    assert loaded.state_dict.keys() == saved.state_dict.keys()
    assert all(torch.equal(loaded.state_dict[k], v) for k, v in saved.state_dict.items())
    assert list(tmp_path.iterdir()) == [tmp_path / "m.safetensors"]


def test_a_fit_of_odometry_comes_back_as_well(tmp_path):
    path, plain = tmp_path / "m.safetensors", make_checkpoint()
    save_checkpoint(path, replace(plain, calibration=replace(plain.calibration, odometry=ODOMETRY)))
    assert load_checkpoint(path).calibration.odometry == ODOMETRY


def test_a_half_precision_demo_model_fits_in_eight_megabytes_and_predicts_the_same_to_millimetres(tmp_path):
    path = tmp_path / "m.safetensors"
    saved = make_checkpoint(NetworkConfig(), num_poses=5000)
    save_checkpoint(path, saved, store_float16=True)
    assert path.stat().st_size <= 8_000_000
    loaded = load_checkpoint(path)
    assert len(loaded.prior_poses) == 2000
    assert all(v.dtype == torch.float32 for v in loaded.state_dict.values() if v.is_floating_point())
    images, noise = torch.randn(2, 3, 128, 128), torch.randn(2, 10, 16)
    with torch.inference_mode():
        before, after = saved.build_network()(images, noise), load_checkpoint(path).build_network()(images, noise)
    assert (before[0] - after[0]).abs().max() < 5e-3
    assert (before[1] - after[1]).abs().max() < 5e-3


def test_thinned_indices_are_evenly_spaced_and_keep_both_ends():
    np.testing.assert_array_equal(spaced(101, 11), np.arange(0, 101, 10))
    np.testing.assert_array_equal(spaced(101, 101), np.arange(101))


def test_an_error_while_saving_leaves_the_old_model_and_no_other_file(tmp_path):
    path = tmp_path / "m.safetensors"
    save_checkpoint(path, make_checkpoint())
    before = path.read_bytes()
    broken = replace(make_checkpoint(), training={"recall": float("nan")})
    with pytest.raises(ValueError, match="JSON"):
        save_checkpoint(path, broken)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def _without(mapping, key):
    return {k: v for k, v in mapping.items() if k != key}


def _edit_config(metadata, change):
    config = json.loads(metadata["config"])
    change(config)
    return {**metadata, "config": json.dumps(config)}


def _edit_errors(metadata, change):
    return _edit_config(metadata, lambda config: change(config["calibration"]["errors"]))


def _errors(edit):
    return lambda t, m: (t, _edit_errors(m, edit))


def _set(part, **values):
    return lambda t, m: (t, _edit_config(m, lambda c: c[part].update(values)))


def _lacking(part, name):
    return lambda t, m: (t, _edit_config(m, lambda c: c[part].pop(name)))


def _with(name, value):
    return lambda t, m: ({**t, name: value(t.get(name))}, m)


HEAD = "network.latent_mean.weight"
MALFORMED = {
    "no metadata": (lambda t, m: (t, {}), "format is None"),
    "another format": (lambda t, m: (t, {**m, "format": "other"}), "format is 'other'"),
    "another version": (lambda t, m: (t, {**m, "version": "1"}), "version is '1', expected '12'; train the model a"),
    "no configuration": (lambda t, m: (t, _without(m, "config")), "expected a JSON object"),
    "configuration that is no JSON": (lambda t, m: (t, {**m, "config": "{"}), "expected JSON"),
    "missing tensor": (lambda t, m: (_without(t, HEAD), m), f"lacks tensor {HEAD}"),
    "surplus tensor": (_with("network.extra", lambda t: torch.zeros(1)), "surplus tensor network.extra"),
    "wrong shape": (_with(HEAD, lambda t: torch.zeros(4, 15)), r"shape \(4, 15\) .* expected shape \(4, 16\)"),
    "tensor with NaN": (_with(HEAD, lambda t: torch.full((4, 16), torch.nan)), f"{HEAD} has values that are"),
    "no training poses": (_with("prior_poses.translation", lambda t: torch.zeros(0, 3)), "expected no empty"),
    "fewer rotations": (_with("prior_poses.rotation", lambda t: torch.zeros(29, 3, 3)), r"expected \(n, 3, 3\)"),
    "missing setting": (_lacking("network", "latent_dim"), "latent_dim"),
    "surplus setting": (_set("calibration", x=1), r"surplus \['x'\]"),
    "setting that is no number": (
        _set("calibration", bandwidth_rotation_rad="much"),
        "bandwidth_rotation_rad 'much', expected a number",
    ),
    "missing errors": (_lacking("calibration", "errors"), r"lacks \['errors"),
    "errors that are none": (_set("calibration", errors=[1.0]), "calibration.errors config"),
    "missing part of errors": (_errors(lambda e: e.pop("spread")), r"lacks \['spread'\]"),
    "number that is NaN": (_errors(lambda e: e.update(degrees_of_freedom=float("nan"))), "degrees_of_freedom is nan"),
    "noise_floor of five": (_errors(lambda e: e.update(noise_floor=[0.1] * 5)), "expected 6 numbers"),
    "noise_floor of zeros": (_errors(lambda e: e.update(noise_floor=[0.0] * 6)), "six positive numbers"),
    "odometry that is none": (_set("calibration", odometry=3), "calibration.odometry configuration"),
    "part of a fit of odometry": (
        _set("calibration", odometry={"scale": 0.1}),
        "calibration.odometry configuration: fit of odometry with",
    ),
    "unknown backbone": (_set("network", backbone="vgg"), "network configuration"),
    "number that must be whole": (_set("network", latent_dim=4.5), "latent_dim 4.5, expected a w"),
    "switch that is none": (_set("network", shortcut=1), "shortcut 1, expected true or"),
    "absurd size": (_set("network", hidden_width=10**12), "hidden_width is 10000"),
    "box turned inside out": (_set("box", lower=[2, 0, 2]), "box from"),
    "whole numbers for weights": (
        _with(HEAD, lambda t: torch.zeros(4, 16, dtype=torch.int64)), f"{HEAD} has .* is of torch.int64"
    ),
    "training poses with NaN": (
        _with("prior_poses.translation", lambda t: torch.full((30, 3), torch.nan)), "not finite"
    ),
    "training poses that mirror": (_with("prior_poses.rotation", lambda t: -t), "30 matrices that are not rot"),
    "flat box": (_set("box", lower=[0, 1]), "3 numbers"),
}  # fmt: skip


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """Metadata and tensors of a model file that is good when they are written unchanged."""
    file = tmp_path_factory.mktemp("good") / "good.safetensors"
    save_checkpoint(file, make_checkpoint())
    metadata, tensors = read_safetensors(file)
    write_safetensors(file, tensors, metadata)
    load_checkpoint(file)
    return metadata, tensors


@pytest.mark.parametrize("case", MALFORMED)
def test_a_malformed_model_is_refused_with_its_file_and_what_is_wrong(good, tmp_path, case):
    change, message = MALFORMED[case]
    (metadata, tensors), bad = good, tmp_path / "bad.safetensors"
    write_safetensors(bad, *change(tensors, metadata))
    with pytest.raises(CheckpointError, match=rf"bad\.safetensors: .*{message}"):
        load_checkpoint(bad)


def test_errors_of_an_uncalibrated_model_are_in_proportion_to_the_scene():
    rng = np.random.default_rng(0)
    poses = Poses.exp(rng.standard_normal((200, 6)))
    small, large = default_errors(poses), default_errors(Poses(poses.rotation, 30.0 * poses.translation))
    expected = small.scaled(30.0)
    assert large.length_m == pytest.approx(expected.length_m)
    assert large.log_clutter_density == pytest.approx(expected.log_clutter_density)
    np.testing.assert_allclose([large.noise_floor, large.typical_std], [expected.noise_floor, expected.typical_std])
    assert 0.1 < small.radius_m < 1.0  # of about nine metres
    assert default_errors(Poses.identity(5)).radius_m > 0  # a camera that only turns, or stands


def test_a_network_without_a_shortcut_is_another_one():
    without = make_checkpoint(replace(SMALL, shortcut=False))
    assert without.network_sha256() != replace(without, network=SMALL).network_sha256()


@pytest.mark.parametrize("damage", ["absent", "empty", "text", "truncated", "folder"])
def test_what_is_no_safetensors_file_is_refused(tmp_path, damage):
    path = tmp_path / "m.safetensors"
    if damage == "folder":
        path.mkdir()
    elif damage != "absent":
        save_checkpoint(path, make_checkpoint())
        content = path.read_bytes()
        path.write_bytes({"empty": b"", "text": b"hello, world", "truncated": content[: len(content) // 2]}[damage])
    with pytest.raises(CheckpointError, match=r"m\.safetensors: .*expected a safetensors file"):
        load_checkpoint(path)


def test_models_are_found_by_path_or_by_the_name_they_ship_under(tmp_path, monkeypatch):
    monkeypatch.setattr(file_format, "SHIPPED", tmp_path)
    for name in ("staircase", "ceiling"):
        (tmp_path / f"{name}.safetensors").write_bytes(b"")
    assert find_model("staircase") == tmp_path / "staircase.safetensors"
    assert find_model(str(tmp_path / "ceiling.safetensors")) == tmp_path / "ceiling.safetensors"
    with pytest.raises(CheckpointError, match=r"atrium: no such model file.*ceiling, staircase"):
        find_model("atrium")


def made_up():
    rng = np.random.default_rng(0)
    camera = Camera(320, 240, 260.0, 260.0, 159.5, 119.5)
    floats = {
        name: rng.standard_normal(shape).astype(np.float16).astype(np.float32)
        for name, shape in (
            ("points", (30, 3)), ("translation", (4, 3)), ("mean", 128), ("axes", (128, 64)), ("words", (2, 64)),
            ("summary_axes", (128, 3)), ("summaries", (4, 3)),
        )
    }  # fmt: skip
    return Landmarks(
        LandmarkMap(
            camera,
            ViewCamera(replace(camera, fx=250.0), 0.1, -0.2),
            2.5,
            descriptors=rng.integers(-127, 128, (30, 64)).astype(np.int8),
            rotation=np.tile(np.eye(3, dtype=np.float32), (4, 1, 1)),
            begins=np.array([0, 5, 5, 12, 20], np.int32),
            shown=rng.integers(0, 30, 20).astype(np.int32),
            **floats,
        ),
        Verification(gain=30.0, clutter=0.2),
    )


def saved(path):
    checkpoint = make_checkpoint()
    noise = replace(checkpoint.calibration.errors, verified=MeasurementNoise(degrees_of_freedom=4.0))
    calibration = replace(checkpoint.calibration, errors=noise)
    checkpoint = replace(checkpoint, calibration=calibration, landmarks=made_up())
    save_checkpoint(path, checkpoint)
    return checkpoint


def test_landmarks_come_back_as_they_were(tmp_path):
    path = tmp_path / "m.safetensors"
    before = saved(path)
    for after in (load_checkpoint(path), load_description(path)):
        assert after.calibration == before.calibration
        assert after.landmarks.verification == before.landmarks.verification
        for name, value in vars(before.landmarks.map).items():
            found = getattr(after.landmarks.map, name)
            if isinstance(value, np.ndarray):
                np.testing.assert_array_equal(found, value)
                assert found.dtype == value.dtype
            else:
                assert found == value
    without = replace(before, landmarks=None)
    assert without.network_sha256() == before.network_sha256()
    assert without.seen_sha256() != before.seen_sha256()
    save_checkpoint(path, without)
    assert load_checkpoint(path).landmarks is None


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (_with("landmarks.shown", lambda t: t + 25), "landmarks.shown has .* expected 0 to 29"),
        (_with("landmarks.begins", lambda t: t.flip(0)), "landmarks.begins does not split"),
        (_with("landmarks.points", lambda t: t * float("nan")), "landmarks.points has values that are not finite"),
        (_with("landmarks.rotation", lambda t: 2.0 * t), "landmarks.rotation has 4 matrices that are not rotations"),
        (_with("landmarks.descriptors", lambda t: t[:, :10].contiguous()), "landmarks.axes has shape"),
        (
            _with("landmarks.descriptors", lambda t: t.float()),
            "landmarks.descriptors has .* type float32, expected .* int8",
        ),
        (
            lambda t, m: (t, _edit_config(m, lambda c: c.pop("landmarks"))),
            r"model configuration lacks \['landmarks'\]",
        ),
        (_set("landmarks", depth_m=-1.0), "depth_m is -1.0"),
        (lambda t, m: (t, _edit_config(m, lambda c: c["landmarks"]["verification"].update(gain=0.0))), "gain is 0.0"),
        (
            lambda t, m: (
                t,
                _edit_config(m, lambda c: c["calibration"]["errors"]["verified"].update(degrees_of_freedom=0.1)),
            ),
            "errors.verified .*degrees_of_freedom is 0.1",
        ),
    ],
)
def test_damaged_landmarks_are_refused(tmp_path, damage, said):
    path, bad = tmp_path / "m.safetensors", tmp_path / "bad.safetensors"
    saved(path)
    metadata, tensors = read_safetensors(path)
    tensors, metadata = damage(tensors, metadata)
    write_safetensors(bad, tensors, _without(metadata, "content_sha256"))
    with pytest.raises(CheckpointError, match=said):
        load_checkpoint(bad)
