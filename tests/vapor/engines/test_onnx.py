"""Exported models: the network and all that it says of itself in one ONNX file, checked; run without torch."""

from dataclasses import replace

import numpy as np
import onnxruntime
import pytest
import torch

from filtering.errors import VaporTrackError
from tests.helpers.engines import an_image, any_checkpoint, noise
from vapor.checkpoints.checkpoint import Checkpoint
from vapor.engines import onnx_export
from vapor.engines.engine import EngineConfig
from vapor.engines.onnx_export import export_onnx
from vapor.engines.onnx_file import describe_onnx, is_exported
from vapor.engines.start import start_engine
from vapor.engines.torch_engine import TorchEngine
from vapor.regressors.registry import REGRESSORS
from vapor.tensor_files import CheckpointError


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """A retrieval network's file, which has all there is to describe, and its checkpoint."""
    checkpoint, file = any_checkpoint("retrieval"), tmp_path_factory.mktemp("exported") / "m.onnx"
    export_onnx(checkpoint, file)
    return checkpoint, file


@pytest.mark.parametrize("head", REGRESSORS)
def test_every_regressor_gives_torchs_poses_and_description_as_onnx(tmp_path, head):
    checkpoint = any_checkpoint(head)
    runtime, metres, radians = export_onnx(checkpoint, tmp_path / "m.onnx")
    assert (runtime, metres < 1e-4, radians < 1e-4) == ("onnxruntime", True, True)
    session = onnxruntime.InferenceSession(str(tmp_path / "m.onnx"))
    torchs, image, columns = TorchEngine(checkpoint, device="cpu"), an_image(), session.get_inputs()[1].shape[1]
    numbers = noise(columns)
    translation, rotation, description = session.run(None, {"image": image, "noise": numbers})
    expected = torchs.run(image, numbers[:, : torchs.noise_dim])
    np.testing.assert_allclose(translation, expected.translation, atol=1e-4)
    np.testing.assert_allclose(rotation, expected.rotation, atol=1e-4)
    np.testing.assert_allclose(description, expected.description, atol=1e-3)
    assert np.ptp(expected.translation, axis=0).max() > 0 or torchs.noise_dim == 0


def test_an_exported_model_says_all_of_itself_but_its_weights(exported):
    checkpoint, file = exported
    told, own = describe_onnx(file), checkpoint.description
    assert (told.network, told.box, told.calibration, told.camera) == (own.network, own.box, own.calibration, None)
    assert (told.training, told.file, told.notices) == ({"seed": 3}, file, ())
    np.testing.assert_array_equal(told.prior_poses.as_matrix(), own.prior_poses.as_matrix())
    np.testing.assert_array_equal(told.memory_poses.as_matrix(), own.memory_poses.as_matrix())
    np.testing.assert_allclose(told.familiarity.exemplars, own.familiarity.exemplars, atol=1e-3)
    assert is_exported(file)


def test_a_damaged_export_and_a_file_that_is_none_are_refused(exported, tmp_path):
    content, rng = exported[1].read_bytes(), np.random.default_rng(0)
    bad = tmp_path / "bad.onnx"
    graph, arrays = content.index(b"relative"), content.index(b"vapor-track arrays")
    for place in (*rng.integers(200, graph, 5), *rng.integers(arrays, len(content), 20)):
        bad.write_bytes(content[:place] + bytes([content[place] ^ 4]) + content[place + 1 :])
        with pytest.raises(CheckpointError, match=r"bad\.onnx: "):
            describe_onnx(bad)
    for other in (b"", b"no model", content[:5000]):
        bad.write_bytes(other)
        assert not is_exported(bad)
        with pytest.raises(CheckpointError, match="no ONNX file of `vapor-track export`, expected one"):
            describe_onnx(bad)


def test_an_export_that_differs_from_torch_is_not_written(tmp_path, monkeypatch):
    def turned(path, runtime, inputs):
        found = run(path, runtime, inputs)
        return [found[0] + 2e-4, *found[1:]]

    run = onnx_export._run
    monkeypatch.setattr(onnx_export, "_run", turned)
    with pytest.raises(VaporTrackError, match=r"gives poses up to 0\.000\d+ m .* from torch's, expected 0\.0001 m"):
        export_onnx(any_checkpoint(), tmp_path / "m.onnx")
    assert list(tmp_path.iterdir()) == []


def test_an_exported_model_runs_by_openvino_only(exported):
    checkpoint, file = exported
    told = describe_onnx(file)
    engine = start_engine(told)
    expected = TorchEngine(checkpoint, device="cpu").run(an_image(), noise(8))
    found = engine.run(an_image(), noise(8))
    np.testing.assert_allclose(found.translation, expected.translation, atol=1e-4)
    assert engine.name == "openvino"
    with pytest.raises(VaporTrackError, match="engine torch with an exported model, expected engine openvino"):
        start_engine(told, EngineConfig("torch"))


def test_what_has_no_familiarity_gives_poses_alone(tmp_path):
    checkpoint = any_checkpoint("point", familiar=False)
    export_onnx(checkpoint, tmp_path / "m.onnx")
    session = onnxruntime.InferenceSession(str(tmp_path / "m.onnx"))
    assert [each.name for each in session.get_outputs()] == ["translation", "rotation"]
    assert describe_onnx(tmp_path / "m.onnx").familiarity is None


def test_a_network_of_numbers_that_are_none_is_not_exported(tmp_path):
    good = any_checkpoint()
    state = {n: torch.full_like(v, torch.nan) if v.is_floating_point() else v for n, v in good.state_dict.items()}
    bad: Checkpoint = replace(good, state_dict=state)
    with pytest.raises(VaporTrackError, match="gives poses up to nan m"):
        export_onnx(bad, tmp_path / "m.onnx")
