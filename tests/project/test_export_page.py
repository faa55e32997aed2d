"""The program in docs/export.md: run as it stands there, it gives what the package gives; and what the page states."""

import ast
import hashlib
import re
import runpy
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import onnxruntime
import pytest

from sequences.frame import Camera
from tests.helpers.checkout import CHECKOUT
from tests.helpers.checkpoints import CONFIG, any_checkpoint
from vapor.cameras import AsTakenBy
from vapor.engines.onnx_export import export_onnx
from vapor.images import prepare
from vapor.observation import VaporObservationModel
from vapor.regressors.network_config import REGRESSORS, make_regressor

PAGE = (CHECKOUT / "docs" / "export.md").read_text(encoding="utf-8")
LEARNED = Camera(160, 128, 120.0, 121.0, 79.0, 64.0)
CAMERAS = {
    "unknown": None,
    "the same": LEARNED,
    "larger": LEARNED.scaled(320, 256),
    "wider": replace(LEARNED, fx=80.0, fy=82.0),
    "wider and larger": replace(LEARNED, fx=85.0, fy=82.0).scaled(640, 512),
    "narrower": replace(LEARNED, fx=180.0, fy=180.0),
    "shifted": replace(LEARNED, cx=70.0),
    "of another aspect": Camera(200, 120, 110.0, 110.0, 99.5, 59.5),
}


@pytest.fixture(scope="module")
def program(tmp_path_factory) -> Path:
    """The program as a file."""
    (code,) = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)
    file = tmp_path_factory.mktemp("program") / "posterior.py"
    file.write_text(code, encoding="utf-8")
    return file


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    """A model that knows the camera of its training and an OOD model, whose edge is longer than its image's; its
    file."""
    checkpoint = replace(any_checkpoint("variational"), camera=LEARNED)
    axes = np.linalg.qr(checkpoint.ood_model.axes)[0]  # so that something of an image is left over
    checkpoint = replace(checkpoint, ood_model=replace(checkpoint.ood_model, axes=axes))
    checkpoint = replace(checkpoint, network=replace(checkpoint.network, shortest_edge=37))
    file = tmp_path_factory.mktemp("exported") / "m.onnx"
    export_onnx(checkpoint, file)
    return checkpoint, file


def an_image(columns: int, rows: int) -> np.ndarray:
    coarse = np.random.default_rng(0).integers(0, 256, (9, 11, 3), dtype=np.uint8)
    return np.asarray(cv2.resize(coarse, (columns, rows), interpolation=cv2.INTER_CUBIC))


def test_the_program_needs_neither_torch_nor_this_package(program):
    nodes = [*ast.walk(ast.parse(program.read_text(encoding="utf-8")))]
    imported = [each.name for node in nodes if isinstance(node, ast.Import) for each in node.names]
    assert sorted(imported) == ["base64", "cv2", "json", "numpy", "onnxruntime", "sys"]
    assert not any(isinstance(node, ast.ImportFrom) for node in nodes)


@pytest.mark.parametrize("camera", CAMERAS)
def test_the_program_sees_and_says_what_the_package_does(camera, program, model):
    checkpoint, file = model
    taken_by = CAMERAS[camera]
    image = an_image(taken_by.width, taken_by.height) if taken_by else an_image(97, 61)
    page = runpy.run_path(str(program))
    ours = VaporObservationModel(checkpoint, num_samples=50, device="cpu", engine="torch", camera=taken_by)
    noise = np.random.default_rng(2).standard_normal((50, ours.engine.noise_dim), dtype=np.float32)
    loaded = page["load"](str(file))
    camera_fields = None if taken_by is None else vars(taken_by)
    translation, rotation, score = page["observe"](loaded, image, noise, camera_fields)

    as_learned = AsTakenBy(checkpoint.camera, checkpoint.network.frame_size)
    seen = prepare(as_learned(image, taken_by), checkpoint.network)
    expected = ours.engine.run(seen, noise)
    np.testing.assert_allclose(translation, expected.translation, atol=1e-4)
    np.testing.assert_allclose(rotation, expected.rotation, atol=1e-4)
    posterior = ours.observe(image, rng=np.random.default_rng(2))
    assert score == pytest.approx(posterior.ood_score, rel=1e-4)
    if taken_by is not None:
        resized, _ = page["as_learned"](image, camera_fields, vars(LEARNED), checkpoint.network.frame_size)
        np.testing.assert_array_equal(page["prepared"](resized, loaded[1]["network"]), seen)


@pytest.mark.parametrize(("raw", "expected"), [(0.9, 0.9), (1.7, 1.0), (1.9, 1.9)])
def test_the_program_allows_for_what_a_narrower_camera_does_not_see(raw, expected, program, model):
    checkpoint, file = model
    camera = CAMERAS["narrower"]  # it sees 45 % of the view: 1 + 1.5 * 0.55 is 1.82
    image = an_image(camera.width, camera.height)
    page = runpy.run_path(str(program))
    session, config, arrays = page["load"](str(file))
    noise = np.zeros((5, session.get_inputs()[1].shape[1]), np.float32)
    *_, score = page["observe"]((session, config, arrays), image, noise, vars(camera))
    threshold = arrays["ood_model.threshold"] * score / raw
    scaled = arrays | {"ood_model.threshold": threshold}
    assert page["observe"]((session, config, scaled), image, noise, vars(camera))[2] == pytest.approx(
        expected, rel=1e-6
    )
    ood_model = replace(checkpoint.ood_model, own_distance=float(threshold), threshold=float(threshold))
    ours = VaporObservationModel(replace(checkpoint, ood_model=ood_model), num_samples=5, device="cpu", camera=camera)
    assert ours.observe(image, rng=np.random.default_rng(2)).ood_score == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("size", [(40, 32), (46, 37), (47, 37), (320, 256), (33, 300), (500, 40), (20, 20), (1, 1)])
def test_the_program_prepares_images_of_any_size_as_the_package_does(size, program, model):
    checkpoint, _ = model
    page, image = runpy.run_path(str(program)), an_image(*size)
    found = page["prepared"](image, vars(checkpoint.network))
    np.testing.assert_array_equal(found, prepare(image, checkpoint.network))


def test_the_program_is_run_from_the_command_line(program, model, tmp_path, monkeypatch, capsys):
    cv2.imwrite(str(tmp_path / "image.png"), an_image(160, 128))
    monkeypatch.setattr(sys, "argv", ["posterior.py", str(model[1]), str(tmp_path / "image.png")])
    runpy.run_path(str(program), run_name="__main__")
    assert re.fullmatch(r"mean \[.*\] m, spread \[.*\] m, ood_score \d+\.\d\d\n", capsys.readouterr().out)


def test_the_page_says_how_much_noise_every_head_takes():
    rows = re.findall(r"^\| (`\w+`(?:, `\w+`)*) \| `?(\w+)`?,?.*\|$", PAGE.partition("| head | d |")[2], re.MULTILINE)
    stated = {head: columns for heads, columns in rows for head in re.findall(r"\w+", heads) if head in REGRESSORS}
    assert stated.keys() == REGRESSORS.keys()
    box = any_checkpoint().box
    for head, columns in stated.items():
        config = replace(CONFIG, head=head)
        number = getattr(config, columns) if columns.isidentifier() else int(columns)
        assert max(1, make_regressor(config, box).noise_dim) == number


def test_the_digest_is_that_of_what_comes_before_the_metadata(model):
    content = model[1].read_bytes()
    stored = onnxruntime.InferenceSession(str(model[1])).get_modelmeta().custom_metadata_map
    first = content.index(b"\x0a\x12vapor-track config")
    begin = content.rindex(b"\x72", 0, first)  # the entry's tag, before its length
    assert stored["vapor-track graph_sha256"] == hashlib.sha256(content[:begin]).hexdigest()
