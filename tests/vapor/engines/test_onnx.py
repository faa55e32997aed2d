"""Exported models: the network and all that it says of itself in one ONNX file, checked; run without torch."""

import json
import os
import time
from functools import cache
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import torch
from onnx import TensorProto, helper

from filtering.errors import VaporTrackError
from tests.helpers.checkpoints import an_image, any_checkpoint, noise
from tests.helpers.exported import GRAPH_BYTES, field, put_together, take_apart, with_config, write_export
from tests.helpers.full import some
from vapor.checkpoints.checkpoint import Checkpoint
from vapor.engines import onnx_export
from vapor.engines.engine import EngineConfig
from vapor.engines.onnx_export import export_onnx
from vapor.engines.onnx_file import describe_onnx, is_exported
from vapor.engines.start import start_engine
from vapor.engines.torch_engine import TorchEngine
from vapor.regressors.network_config import REGRESSORS
from vapor.tensor_files import CheckpointError


@pytest.fixture(scope="module")
def of_head(tmp_path_factory):
    """The checkpoint of a head, its exported file and what the export said; of each head once."""

    @cache
    def export(head: str) -> tuple[Checkpoint, Path, tuple[float, float]]:
        checkpoint, file = any_checkpoint(head), tmp_path_factory.mktemp(head) / "m.onnx"
        return checkpoint, file, export_onnx(checkpoint, file)

    return export


@pytest.fixture
def exported(of_head):
    """A retrieval network's file, which has all there is to describe, and its checkpoint."""
    return of_head("retrieval")[:2]


@pytest.mark.parametrize("head", some(4, [*REGRESSORS]))
def test_every_regressor_gives_torchs_poses_and_description_as_onnx(of_head, head):
    checkpoint, file, (metres, radians) = of_head(head)
    assert (metres < 1e-4, radians < 1e-4) == (True, True)
    session = onnxruntime.InferenceSession(str(file))
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
    assert (told.training, told.file) == ({"seed": 3}, file)
    np.testing.assert_array_equal(told.prior_poses.as_matrix(), own.prior_poses.as_matrix())
    np.testing.assert_array_equal(told.memory_poses.as_matrix(), own.memory_poses.as_matrix())
    np.testing.assert_allclose(told.ood_model.exemplars, own.ood_model.exemplars, atol=1e-3)
    assert is_exported(file)


def refused(file: Path) -> str:
    """Why a file is refused, in a line that names it and says what was expected."""
    with pytest.raises(CheckpointError) as found:
        describe_onnx(file)
    said = str(found.value)
    assert said.startswith(f"{file}: ")
    assert "expected" in said
    assert "\n" not in said
    return said


def test_a_damaged_export_and_a_file_that_is_none_are_refused(exported, tmp_path):
    content, rng = exported[1].read_bytes(), np.random.default_rng(0)
    bad = tmp_path / "bad.onnx"
    graph, arrays = content.index(b"relative"), content.index(b"vapor-track arrays")
    for place in (*rng.integers(200, graph, 5), *rng.integers(arrays, len(content), 20)):
        bad.write_bytes(content[:place] + bytes([content[place] ^ 4]) + content[place + 1 :])
        refused(bad)
    for other in (b"", b"no model", content[:5000]):
        bad.write_bytes(other)
        assert not is_exported(bad)
        assert "no ONNX file of `vapor-track export`, or cut off, expected one" in refused(bad)


@pytest.fixture
def here(tmp_path, monkeypatch):
    """The working directory, so that names of files are short and messages whole."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def small(here):
    """An exported model of a few thousand bytes, whose graph is none."""
    return write_export(Path("m.onnx"), any_checkpoint().description)


def test_an_export_that_is_cut_off_anywhere_is_refused(small):
    content = small.read_bytes()
    describe_onnx(small)
    for length in (*range(200), *range(200, len(content), 97), *range(len(content) - 100, len(content))):
        small.write_bytes(content[:length])
        refused(small)


OUT_OF_DISTRIBUTION = helper.make_model(
    helper.make_graph(
        [helper.make_node("Identity", ["image"], ["out"])],
        "foreign",
        [helper.make_tensor_value_info("image", TensorProto.UINT8, [32, 40, 3])],
        [helper.make_tensor_value_info("out", TensorProto.UINT8, [32, 40, 3])],
    )
).SerializeToString()


@pytest.mark.parametrize(
    "content",
    [
        OUT_OF_DISTRIBUTION,
        put_together(OUT_OF_DISTRIBUTION, [(b"author", b"another"), (b"vapor-track config", b"{}")]),
        put_together(GRAPH_BYTES, [(b"vapor-track arrays", b"no base64"), (b"vapor-track graph_sha256", b"")]),
        b"\xff" * 10**6,
        b"\x3a" + b"\x80" * 10 + b"\x01",
        b"\x08\x01" * 10**7,
        field(14, b"\x08\x01" * 10**7),
        b"\x3a\xff\xff\xff\xff\xff\xff\xff\xff\xff\x01",
    ],
    ids=["foreign", "foreign config", "no base64", "no end", "long number", "fields", "fields in an entry", "length"],
)
def test_another_file_is_refused_at_once(content, here):
    Path("m.onnx").write_bytes(content)
    begin = time.process_time()
    assert "no ONNX file of `vapor-track export`, or cut off, expected one" in refused(Path("m.onnx"))
    assert time.process_time() - begin < 1.0


def test_what_is_no_file_or_far_too_large_is_refused_without_being_read(here):
    assert "no such file" in refused(Path("absent.onnx"))
    Path("folder.onnx").mkdir()
    assert "no such file" in refused(Path("folder.onnx"))
    os.mkfifo("pipe.onnx")
    assert "no such file" in refused(Path("pipe.onnx"))
    with Path("large.onnx").open("wb") as file:
        file.truncate(2**40)
    assert "has 1099511627776 bytes" in refused(Path("large.onnx"))
    assert not is_exported(Path("large.onnx"))
    with pytest.raises(CheckpointError, match=r"cannot be read \(File name too long\), expected an ONNX file"):
        describe_onnx(Path("a" * 300 + ".onnx"))


@pytest.mark.parametrize("name", [b"vapor-track config", b"vapor-track arrays", b"vapor-track graph_sha256", b"other"])
def test_metadata_that_are_there_twice_or_are_no_text_are_refused(name, small):
    graph, entries = take_apart(small.read_bytes())
    described = describe_onnx(small)
    small.write_bytes(put_together(graph, [*entries, (b"other", b"of another program")]))
    assert describe_onnx(small).network == described.network
    for more in ([(name, b"1"), (name, b"1")], [(name + b"\xff", b"1")], [(b"text", name + b"\xff")]):
        small.write_bytes(put_together(graph, [*entries, *more]))
        assert "no ONNX file of `vapor-track export`" in refused(small)


def test_another_graph_or_version_of_its_operators_is_refused(small):
    graph, entries = take_apart(small.read_bytes())
    for place in range(len(graph)):  # the last byte is the operators' version
        small.write_bytes(put_together(graph[:place] + bytes([graph[place] ^ 1]) + graph[place + 1 :], entries))
        refused(small)
    small.write_bytes(put_together(graph[:-1] + b"\x12", entries))
    assert "damaged: its graph does not match its digest" in refused(small)
    small.write_bytes(put_together(graph, entries) + field(7, b"\x12\x01a"))  # readers merge it with the first
    assert "damaged: its graph does not match its digest" in refused(small)


def test_settings_for_all_to_read_that_were_changed_alone_are_refused(small):
    graph, entries = take_apart(small.read_bytes())
    name, config = entries[0]
    small.write_bytes(put_together(graph, [(name, config.replace(b"40", b"41")), *entries[1:]]))
    assert "'vapor-track config' in its metadata differs from 'vapor-track arrays'" in refused(small)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        (lambda c: c["network"].update(image_width=10**9), "image_width 1000000000"),
        (lambda c: c["network"].update(head="os.system"), "head is 'os.system', expected one of"),
        (lambda c: c.update(training=7), "training 7, expected an object"),
        (lambda c: c.update(calibration={"errors": 1e999}), "configuration"),
    ],
)
@pytest.mark.usefixtures("unchecked")
def test_a_configuration_of_wrong_values_is_refused_though_checksums_fit(changed, said, small):
    content = small.read_bytes()
    config = json.loads(take_apart(content)[1][0][1])
    changed(config)
    small.write_bytes(with_config(content, json.dumps(config)))
    assert said in refused(small)


def graph_of(image: list, noise: list, outputs: tuple[str, ...], operator: str = "Identity") -> bytes:
    """A graph of other inputs, outputs or operators than an exported model has."""
    shapes = {"translation": ["m", 3], "rotation": ["m", 3, 3]}
    nodes = [helper.make_node(operator, ["noise"], [name]) for name in outputs]
    graph = helper.make_graph(
        nodes,
        "other",
        [
            helper.make_tensor_value_info("image", TensorProto.UINT8, image),
            helper.make_tensor_value_info("noise", TensorProto.FLOAT, noise),
        ],
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, shapes[name]) for name in outputs],
    )
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8).SerializeToString()


@pytest.mark.parametrize(
    ("graph", "said"),
    [
        (
            graph_of([32, 40, 3], ["m", 3], ("translation",), "Unknown"),
            "OpenVINO cannot compile the network in float32 (",
        ),
        (GRAPH_BYTES, "its network has no inputs; expected image"),
        (graph_of([32, 40, 3], ["m", 3], ("translation",)), "expected image u8 [32,40,3], noise f32 [?,d], trans"),
        (graph_of([64, 40, 3], ["m", 3], ("translation", "rotation")), "image u8 [64,40,3]"),
        (graph_of([32, 40, 3], ["m", 10**6], ("translation", "rotation")), "noise f32 [?,1000000]"),
    ],
    ids=["unknown operator", "no graph", "one output", "other image", "much noise"],
)
def test_another_network_whose_digest_fits_is_not_run(graph, said, here):
    told = describe_onnx(write_export(Path("m.onnx"), any_checkpoint(in_distribution=False).description, graph))
    with pytest.raises(VaporTrackError) as found:
        start_engine(told)
    assert said in str(found.value)
    assert str(found.value).startswith("m.onnx: ")
    assert "\n" not in str(found.value)


@pytest.fixture
def written_before(of_head, monkeypatch) -> None:
    """A variational network is not exported anew where a test looks at what becomes of its graph."""
    graph, _ = take_apart(of_head("variational")[1].read_bytes())
    monkeypatch.setattr(onnx_export, "_write", lambda _, path: path.write_bytes(graph))


@pytest.mark.usefixtures("written_before")
def test_an_export_that_differs_from_torch_is_not_written(tmp_path, monkeypatch):
    def turned(path, inputs):
        found = run(path, inputs)
        return [found[0] + 2e-4, *found[1:]]

    run = onnx_export._run
    monkeypatch.setattr(onnx_export, "_run", turned)
    with pytest.raises(VaporTrackError, match=r"gives poses up to 0\.000\d+ m .* from torch's, expected 0\.0001 m"):
        export_onnx(any_checkpoint(), tmp_path / "m.onnx")
    assert list(tmp_path.iterdir()) == []


def test_a_network_that_torch_cannot_export_is_refused_in_a_line(tmp_path, monkeypatch):
    def fail(*_: object, **__: object) -> None:
        raise RuntimeError("no such operator\nin this version")

    monkeypatch.setattr(torch.onnx, "export", fail)
    said = r"^export: a network with head 'variational' cannot be exported \(no such operator\)$"
    with pytest.raises(VaporTrackError, match=said):
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
    with pytest.raises(VaporTrackError, match="an exported model with engine torch, expected engine openvino"):
        start_engine(told, EngineConfig("torch"))


def test_what_has_no_ood_model_gives_poses_alone(tmp_path):
    checkpoint = any_checkpoint("point", in_distribution=False)
    export_onnx(checkpoint, tmp_path / "m.onnx")
    session = onnxruntime.InferenceSession(str(tmp_path / "m.onnx"))
    assert [each.name for each in session.get_outputs()] == ["translation", "rotation"]
    assert describe_onnx(tmp_path / "m.onnx").ood_model is None
