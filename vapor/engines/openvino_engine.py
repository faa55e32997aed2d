"""Networks run by OpenVINO, on processors: converted, compiled, and kept in the user's cache."""

from __future__ import annotations

import hashlib
import importlib
import importlib.metadata
import io
import json
import os
import re
import sys
import warnings
from contextlib import suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float32, UInt8

from filtering.errors import VaporTrackError
from vapor.checkpoints.checkpoint import Checkpoint, ModelDescription
from vapor.engines.engine import EngineName, Precision, Seen
from vapor.tensor_files import CheckpointError, read_stored, write_safetensors

if TYPE_CHECKING:
    import openvino

_HINTS = {"float32": "f32", "bfloat16": "bf16"}
_TELEMETRY = "openvino_telemetry"
_CPU_FLAGS = Path("/proc/cpuinfo")
_FLAG_LINES = "flags", "Features"  # of x86 and Arm
_BFLOAT16_FLAGS = {"avx512_bf16", "amx_bf16", "bf16"}  # of Intel and AMD, Intel, and Arm

_FORMAT = "vapor-track compiled network"
_BLOB = "blob"
_NOISE = re.compile(r"noise f32 \[\?,[1-9]\d{0,4}]")  # columns: no regressor takes more, which would fill the memory
_POSES = "translation f32 [?,3], rotation f32 [?,3,3]"


class OpenVINOEngine:
    """A network that OpenVINO runs, in a thread of its own that sleeps between images."""

    name: EngineName = "openvino"
    device = "cpu"

    def __init__(self, compiled: openvino.CompiledModel) -> None:
        self._request = compiled.create_infer_request()
        self._outputs = len(compiled.outputs)
        self.noise_dim: int = compiled.inputs[1].partial_shape[1].get_length()

    def run(self, image: UInt8[np.ndarray, "h w 3"], noise: Float32[np.ndarray, "m d"]) -> Seen:
        """The network's output for an image."""
        found = self._request.infer([np.ascontiguousarray(image), noise], share_inputs=True)
        translation, rotation, *description = (found[number] for number in range(self._outputs))
        return Seen(translation, rotation, description[0] if description else np.zeros(0, np.float32))


def is_installed() -> bool:
    """Whether OpenVINO can be imported."""
    return find_spec("openvino") is not None


def imported() -> ModuleType:
    """OpenVINO without its telemetry, to which no user of this package agreed.

    It reports every import and conversion to the Internet, from forks of this process, and a fork of a process with
    threads can hang. Where the telemetry cannot be imported OpenVINO does without, permanently.
    """
    hidden = sys.modules.keys().isdisjoint({"openvino", _TELEMETRY})
    if hidden:
        sys.modules[_TELEMETRY] = None  # pyright: ignore[reportArgumentType]  # an import of it fails
    try:
        return importlib.import_module("openvino")  # which waits where another thread is about it
    finally:
        if hidden:
            sys.modules.pop(_TELEMETRY, None)


def version() -> str:
    """Version of OpenVINO."""
    return imported().__version__


def require_installed() -> None:
    """Raise a VaporTrackError where OpenVINO is not installed."""
    if not is_installed():
        raise VaporTrackError(
            "OpenVINO is not installed, expected it for engine openvino, for exported models and for bfloat16 on a"
            " processor: pip install 'vapor-track[openvino]'"
        )


def require_bfloat16() -> None:
    """Raise a VaporTrackError where the processor has no bfloat16: OpenVINO would do without, and round all the same.

    OpenVINO itself is asked only where the system does not list the processor's instructions.
    """
    if _CPU_FLAGS.is_file():
        lines = (line.partition(":") for line in _CPU_FLAGS.read_text(encoding="utf-8").splitlines())
        has = any(_BFLOAT16_FLAGS & set(value.split()) for name, _, value in lines if name.strip() in _FLAG_LINES)
    else:
        has = "BF16" in imported().Core().get_property("CPU", "OPTIMIZATION_CAPABILITIES")
    if not has:
        raise VaporTrackError("precision bfloat16: this processor has no arithmetic for it, expected float32")


def converted_network(checkpoint: Checkpoint) -> openvino.Model:
    """A model's network as OpenVINO has it before it is compiled; BatchNorm becomes part of the convolutions then."""
    import torch

    from vapor.engines.torch_engine import WholeNetwork, traced_inputs

    openvino = imported()
    whole = WholeNetwork(checkpoint).eval()
    inputs = traced_inputs(whole)
    with torch.no_grad(), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that Python numbers become constants
        traced = torch.jit.trace(whole, inputs, check_trace=False)
        shapes = [openvino.PartialShape(list(inputs[0].shape)), openvino.PartialShape([-1, inputs[1].shape[1]])]
        return openvino.convert_model(traced, example_input=inputs, input=shapes)


def require_ports(compiled: openvino.CompiledModel, model: ModelDescription) -> None:
    """Raise CheckpointError where an exported network has other inputs or outputs than its description states."""
    found = ", ".join(
        f"{port.get_any_name()} {port.element_type.to_string()} {port.partial_shape}"
        for port in (*compiled.inputs, *compiled.outputs)
    )
    size, known = model.network, model.ood_model
    expected = f"image u8 [{size.image_height},{size.image_width},3], noise f32 [?,d], {_POSES}"
    expected += f", description f32 [{len(known.centre)}]" if known is not None else ""
    if _NOISE.sub("noise f32 [?,d]", found) != expected:
        raise CheckpointError(f"{model.file}: its network has {found or 'no inputs'}; expected {expected}")


def last_line(error: Exception) -> str:
    """The last of the many lines of an error of OpenVINO, its most informative one."""
    return (str(error).strip().splitlines() or [type(error).__name__])[-1]


def compile_network(model: openvino.Model | Path | None, precision: Precision, threads: int) -> openvino.CompiledModel:
    """A network compiled for this processor, from OpenVINO's own form or from an ONNX file.

    Raises:
        RuntimeError: the file cannot be used, or the processor lacks the precision's arithmetic.
    """
    return imported().Core().compile_model(model, "CPU", _settings(precision, threads))


def compiled_network(blob: bytes, precision: Precision, threads: int) -> openvino.CompiledModel:
    """A network that was compiled before, from the result of `CompiledModel.export_model`.

    Raises:
        RuntimeError: it cannot be used here.
    """
    return imported().Core().import_model(io.BytesIO(blob), "CPU", _settings(precision, threads))


def _settings(precision: Precision, threads: int) -> dict[str, object]:
    return {
        "INFERENCE_PRECISION_HINT": _HINTS[precision],
        "INFERENCE_NUM_THREADS": threads,
        "NUM_STREAMS": 1,
        "ENABLE_CPU_PINNING": False,  # several processes would all take the first processors
    }


def processor() -> str:
    """Name of the processor that compiled networks depend on."""
    return imported().Core().get_property("CPU", "FULL_DEVICE_NAME")


@dataclass(frozen=True)
class Compiled:
    """A compiled network.

    Attributes:
        blob: OpenVINO's form of the network.
        faster: Whether it was faster than torch when it was compiled; None where torch was not timed.
    """

    blob: bytes
    faster: bool | None


def cache_folder() -> Path:
    """Folder of compiled networks, in the user's cache."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "vapor-track" / "compiled"


def can_be_kept() -> bool:
    """Whether compiled networks can be kept; the folder is created."""
    folder = cache_folder()
    with suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
    return os.access(folder, os.W_OK)


class KeptNetwork:
    """The file of a model's compiled network: one for each precision and processor, replaced when the model changes."""

    def __init__(self, model: ModelDescription, precision: Precision) -> None:
        assert model.file is not None
        place = hashlib.sha256(os.fsencode(model.file.resolve()) + f"\n{precision}\n{processor()}".encode())
        self.file = cache_folder() / f"{place.hexdigest()[:16]}.safetensors"
        self._made_of = {
            "network": model.network_sha256,
            "described": model.ood_model is not None,
            "openvino": version(),
            "package": importlib.metadata.version("vapor-track"),
        }

    def read(self) -> Compiled | None:
        """The compiled network, if a usable one is kept."""
        with suppress(CheckpointError, ValueError, KeyError, TypeError):
            metadata, tensors = read_stored(self.file)
            config = json.loads(metadata["config"])
            if config["made_of"] == self._made_of:
                return Compiled(bytes(tensors[_BLOB].data), config["faster"])
        return None

    def write(self, compiled: Compiled) -> bool:
        """Keep a compiled network; returns whether that was possible."""
        config = {"made_of": self._made_of, "faster": compiled.faster}
        metadata = {"format": _FORMAT, "config": json.dumps(config)}
        try:
            self.file.parent.mkdir(parents=True, exist_ok=True)
            write_safetensors(self.file, {_BLOB: np.frombuffer(compiled.blob, np.uint8)}, metadata)
        except (OSError, VaporTrackError):
            return False
        return True
