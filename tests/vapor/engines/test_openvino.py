"""Networks run by OpenVINO: as torch runs them, compiled once, and refused in a line where it cannot be."""

import os
import subprocess
import sys
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from filtering.errors import VaporTrackError
from tests.helpers.checkout import CHECKOUT
from tests.helpers.checkpoints import an_image, any_checkpoint, noise
from tests.helpers.full import full
from tests.helpers.tiny_model import SMALL
from vapor.checkpoints.file_format import load_checkpoint, save_checkpoint
from vapor.engines import openvino_engine, start
from vapor.engines.engine import Engine, EngineConfig
from vapor.engines.openvino_engine import KeptNetwork, cache_folder
from vapor.engines.start import describe, start_engine
from vapor.engines.torch_engine import TorchEngine

OPENVINO = EngineConfig("openvino")


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model file that is compiled already, in float32."""
    file = tmp_path_factory.mktemp("compiled") / "model.safetensors"
    save_checkpoint(file, any_checkpoint())
    start_engine(describe(file), OPENVINO)
    return file


@pytest.fixture
def kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compiled networks are kept, as they are outside of the tests; and none is compiled anew."""

    def refuse(*_: object) -> None:
        raise AssertionError("compiled once more")

    monkeypatch.setattr(start, "can_be_kept", openvino_engine.can_be_kept)
    monkeypatch.setattr(openvino_engine, "compile_network", refuse)


def poses(engine: Engine) -> np.ndarray:
    seen = engine.run(an_image(), noise(4))
    return np.concatenate([seen.translation, seen.rotation.reshape(-1, 9)], axis=1)


def test_openvino_gives_what_torch_gives_within_rounding(model: Path) -> None:
    torchs = TorchEngine(load_checkpoint(model), device="cpu").run(an_image(), noise(4))
    found = start_engine(describe(model), OPENVINO).run(an_image(), noise(4))
    np.testing.assert_allclose(found.translation, torchs.translation, atol=1e-5)
    np.testing.assert_allclose(found.rotation, torchs.rotation, atol=1e-5)
    np.testing.assert_allclose(found.description, torchs.description, atol=1e-4)


def test_bfloat16_rounds_and_float32_does_not(model: Path) -> None:
    if "BF16" not in openvino_engine.imported().Core().get_property("CPU", "OPTIMIZATION_CAPABILITIES"):
        pytest.skip("this processor has no arithmetic for bfloat16")
    exact = poses(start_engine(describe(model), OPENVINO))
    rounded = poses(start_engine(describe(model), EngineConfig("openvino", "bfloat16")))
    assert 1e-4 < np.abs(rounded - exact).max() < 0.3


@pytest.mark.usefixtures("kept")
def test_a_network_is_compiled_once_and_then_gives_the_same_bits(model: Path) -> None:
    assert [file.name for file in model.parent.iterdir()] == [model.name]
    first, second = (poses(start_engine(describe(model), OPENVINO)) for _ in range(2))
    np.testing.assert_array_equal(first, second)


@pytest.mark.usefixtures("kept")
def test_auto_takes_what_was_faster_when_the_network_was_compiled(model: Path) -> None:
    described = describe(model)
    place = KeptNetwork(described, "float32")
    compiled = place.read()
    assert compiled is not None
    for faster, name in ((True, "openvino"), (False, "torch")):
        place.write(replace(compiled, faster=faster))
        assert start_engine(described).name == name
    assert start_engine(described, OPENVINO).name == "openvino"


def test_what_is_kept_but_damaged_or_of_another_model_is_compiled_anew(model: Path, tmp_path: Path) -> None:
    file = tmp_path / "model.safetensors"
    file.write_bytes(model.read_bytes())
    expected = poses(start_engine(describe(file), OPENVINO))
    compiled = KeptNetwork(describe(file), "float32").file
    compiled.write_bytes(compiled.read_bytes()[:-100])
    np.testing.assert_array_equal(poses(start_engine(describe(file), OPENVINO)), expected)
    state = load_checkpoint(file).state_dict
    other = {name: value + 0.1 if value.is_floating_point() else value for name, value in state.items()}
    save_checkpoint(file, replace(load_checkpoint(file), state_dict=other))
    assert np.abs(poses(start_engine(describe(file), OPENVINO)) - expected).max() > 1e-3
    assert KeptNetwork(describe(file), "float32").file == compiled  # which replaced the former network's


def test_without_a_cache_that_can_be_written_openvino_runs_where_it_is_asked_for_and_auto_is_torch(
    model: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "vapor-track").write_text("no folder")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(start, "can_be_kept", openvino_engine.can_be_kept)
    assert start_engine(describe(model), OPENVINO).name == "openvino"
    assert start_engine(describe(model)).name == "torch"
    assert not cache_folder().exists()


@full
def test_a_run_by_openvino_loads_no_torch(model: Path, walk_of_25: Path, tmp_path: Path) -> None:
    words = ["run", str(walk_of_25), "--model", str(model), "--output", str(tmp_path / "out"), "--duration-s", "0.5"]
    words += [*SMALL[2:], "--engine", "openvino", "--no-recording"]
    code = f"import sys; from vapor.track import main; sys.exit(main({words}) or 3 * ('torch' in sys.modules))"
    ran = subprocess.run(
        [sys.executable, "-c", code], env=os.environ | {"PYTHONPATH": str(CHECKOUT)}, capture_output=True, text=True
    )
    assert ran.returncode == 0, ran.stderr[-500:]


COUNTED = """
import os, sys
forks = []
os.register_at_fork(before=lambda: forks.append(1))
from pathlib import Path
from vapor.engines.engine import EngineConfig
from vapor.engines.start import describe, start_engine
for kept in (False, True):
    assert start_engine(describe(Path(sys.argv[1])), EngineConfig("openvino")).name == "openvino"
sys.exit(len(forks) or "openvino_telemetry" in sys.modules)
"""


def test_neither_compiling_nor_loading_a_network_forks_or_loads_what_tells_the_internet(
    model: Path, tmp_path: Path
) -> None:
    file = tmp_path / "model.safetensors"
    file.write_bytes(model.read_bytes())
    ran = subprocess.run(
        [sys.executable, "-c", COUNTED, str(file)],
        env=os.environ | {"PYTHONPATH": str(CHECKOUT), "HOME": str(tmp_path), "XDG_CACHE_HOME": ""},
        capture_output=True,
        text=True,
    )
    assert ran.returncode == 0, ran.stderr[-500:]
    assert not (tmp_path / "intel").exists()


def test_an_engine_that_is_not_installed_says_how_to_install_it(model: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(openvino_engine, "find_spec", lambda name: None if name == "openvino" else find_spec(name))
    with pytest.raises(VaporTrackError, match=r"OpenVINO is not installed.*pip install 'vapor-track\[openvino\]'"):
        start_engine(describe(model), OPENVINO)
    assert start_engine(describe(model)).name == "torch"
    with pytest.raises(VaporTrackError, match="OpenVINO is not installed"):
        start_engine(describe(model), EngineConfig("auto", "bfloat16"), device="cpu")


def test_a_processor_without_bfloat16_is_told_so(model: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    old = tmp_path / "cpuinfo"
    old.write_text("flags\t\t: fpu sse2 avx2\n")
    monkeypatch.setattr(openvino_engine, "_CPU_FLAGS", old)
    with pytest.raises(VaporTrackError, match="precision bfloat16: this processor has no arithmetic for it"):
        start_engine(describe(model), EngineConfig("auto", "bfloat16"))


def test_engines_that_do_not_go_with_a_device_are_refused(model: Path) -> None:
    with pytest.raises(VaporTrackError, match="engine openvino with device cuda"):
        start_engine(describe(model), OPENVINO, device="cuda")
    with pytest.raises(VaporTrackError, match="precision bfloat16: torch is slow with it on processors"):
        start_engine(describe(model), EngineConfig("torch", "bfloat16"), device="cpu")
