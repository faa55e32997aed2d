"""Landmarks in a model file: read as they were written, or refused with what is wrong."""

import json
from dataclasses import replace

import numpy as np
import pytest

from filtering.error_model import ErrorModel
from sequences.frame import Camera
from tests.helpers.checkpoints import make_checkpoint
from vapor.checkpoints.file_format import load_checkpoint, load_description, save_checkpoint
from vapor.landmarks.landmark_map import LandmarkMap, ViewCamera
from vapor.landmarks.verify import Landmarks, Verification
from vapor.tensor_files import CheckpointError, read_safetensors, write_safetensors


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
        Verification(gain=30.0, nothing=0.2),
    )


def saved(path):
    checkpoint = make_checkpoint()
    errors = replace(checkpoint.calibration.errors, verified=ErrorModel(tail=4.0))
    calibration = replace(checkpoint.calibration, errors=errors)
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


def _config(change):
    def changed(tensors, metadata):
        config = json.loads(metadata["config"])
        change(config)
        return tensors, {**metadata, "config": json.dumps(config)}

    return changed


def _tensor(name, change):
    def changed(tensors, metadata):
        return {**tensors, f"landmarks.{name}": change(tensors[f"landmarks.{name}"])}, metadata

    return changed


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (_tensor("shown", lambda t: t + 25), "landmarks.shown has .* expected 0 to 29"),
        (_tensor("begins", lambda t: t.flip(0)), "landmarks.begins does not split"),
        (_tensor("points", lambda t: t * float("nan")), "landmarks.points has values that are not finite"),
        (_tensor("rotation", lambda t: 2.0 * t), "landmarks.rotation has 4 matrices that are not rotations"),
        (_tensor("descriptors", lambda t: t[:, :10].contiguous()), "landmarks.descriptors has shape"),
        (_tensor("descriptors", lambda t: t.float()), "landmarks.descriptors is of torch.float32, expected torch.int8"),
        (lambda t, m: ({k: v for k, v in t.items() if k != "landmarks.words"}, m), "lacks tensor landmarks.words"),
        (_config(lambda c: c.pop("landmarks")), "landmarks configuration is None with tensors"),
        (_config(lambda c: c["landmarks"].update(depth_m=-1.0)), "lie -1.0 m away"),
        (_config(lambda c: c["landmarks"].update(k1="x")), "landmarks configuration has k1 'x'"),
        (_config(lambda c: c["landmarks"]["verification"].update(gain=0.0)), "gain is 0.0"),
        (_config(lambda c: c["calibration"]["errors"]["verified"].update(tail=0.1)), "errors.verified .*tail is 0.1"),
    ],
)
def test_damaged_landmarks_are_refused(tmp_path, damage, said):
    path, bad = tmp_path / "m.safetensors", tmp_path / "bad.safetensors"
    saved(path)
    metadata, tensors = read_safetensors(path)
    tensors, metadata = damage(tensors, metadata)
    write_safetensors(bad, tensors, {k: v for k, v in metadata.items() if k != "content_sha256"})
    with pytest.raises(CheckpointError, match=said):
        load_checkpoint(bad)
