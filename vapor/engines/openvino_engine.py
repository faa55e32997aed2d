"""Networks run by OpenVINO, on processors: converted, compiled, and kept beside the model or in the user's cache."""

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
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float32, UInt8

from filtering.errors import VaporTrackError
from sequences.atomic import CACHE
from vapor.checkpoints.checkpoint import Checkpoint, ModelDescription
from vapor.engines.engine import EngineName, Precision, Seen
from vapor.tensor_files import CheckpointError, read_stored, write_arrays

if TYPE_CHECKING:
    import openvino

_HINTS = {"float32": "f32", "bfloat16": "bf16"}
_TELEMETRY = "openvino_telemetry"
_CPU_FLAGS = Path("/proc/cpuinfo")
_FLAG_LINES = "flags", "Features"  # of x86 and Arm
_BFLOAT16_FLAGS = {"avx512_bf16", "amx_bf16", "bf16"}  # of Intel and AMD, Intel, and Arm

_NOISE = re.compile(r"noise f32 \[\?,[1-9]\d{0,4}]")  # columns: no regressor takes more, which would fill the memory
_POSES = "translation f32 [?,3], rotation f32 [?,3,3]"
_FORMAT = "vapor-track compiled network"
_VERSION = "1"
_BLOB = "blob"


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


def require_installed(feature: str) -> None:
    """Raise a VaporTrackError that names the feature where OpenVINO is not installed."""
    if not is_installed():
        raise VaporTrackError(f"{feature}: OpenVINO is not installed, expected it: pip install 'vapor-track[openvino]'")


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


def compile_exported(model: ModelDescription, precision: Precision, threads: int) -> openvino.CompiledModel:
    """The network of an exported model compiled for this processor.

    Raises:
        CheckpointError: its file has none that can be compiled, or one of other inputs and outputs than it should have.
    """
    assert model.file is not None
    try:
        compiled = compile_network(model.file, precision, threads)
        found = ", ".join(
            f"{port.get_any_name()} {port.element_type.to_string()} {port.partial_shape}"
            for port in (*compiled.inputs, *compiled.outputs)
        )
    except RuntimeError as error:
        raise CheckpointError(
            f"{model.file}: OpenVINO cannot compile its network ({last_line(error)}), expected the file as written"
        ) from error
    size, known = model.network, model.ood_model
    expected = f"image u8 [{size.image_height},{size.image_width},3], noise f32 [?,d], {_POSES}"
    expected += f", description f32 [{len(known.centre)}]" if known is not None else ""
    if _NOISE.sub("noise f32 [?,d]", found) != expected:
        raise CheckpointError(f"{model.file}: its network has {found or 'no inputs'}; expected {expected}")
    return compiled


def last_line(error: RuntimeError) -> str:
    """The last of the many lines of an error of OpenVINO, its most informative one."""
    return (str(error).strip().splitlines() or [type(error).__name__])[-1]


def compile_network(model: openvino.Model | Path, precision: Precision, threads: int) -> openvino.CompiledModel:
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
class Variant:
    """Everything that a compiled network depends on: `network` is a digest, `described` whether it describes images."""

    network: str
    described: bool
    precision: str
    processor: str
    openvino: str
    package: str = importlib.metadata.version("vapor-track")

    @property
    def name(self) -> str:
        """Suffix of its file after the model's name: first a part that all valid variants of a model share."""
        return f"{_digest(self.network, self.openvino, self.package)}-{_digest(*map(str, asdict(self).values()))}"


@dataclass(frozen=True)
class Compiled:
    """A compiled network.

    Attributes:
        blob: OpenVINO's form of it.
        faster: Whether it was faster than torch when it was compiled; None where torch was not timed.
    """

    blob: bytes
    faster: bool | None


def read_compiled(model: Path, variant: Variant) -> Compiled | None:
    """The compiled network of a model file; None where there is none that can be used."""
    for folder in _folders(model):
        file = folder / f"{model.name}-{variant.name}"
        with suppress(CheckpointError, ValueError, KeyError, TypeError):
            metadata, tensors = read_stored(file)
            config = json.loads(metadata["config"])
            if (metadata["format"], metadata["version"], config["variant"]) == (_FORMAT, _VERSION, asdict(variant)):
                return Compiled(bytes(tensors[_BLOB].data), config["faster"])
    return None


def write_compiled(model: Path, variant: Variant, compiled: Compiled) -> bool:
    """Keep a compiled network in place of invalid ones of the same model; returns whether that was possible.

    The file appears when it is complete; of two processes the last one's stays.
    """
    config = {"variant": asdict(variant), "faster": compiled.faster}
    metadata = {"format": _FORMAT, "version": _VERSION, "config": json.dumps(config)}
    for folder in _folders(model):
        try:
            folder.mkdir(parents=folder != _beside(model), exist_ok=True)
            ignore = folder / ".gitignore"
            if not ignore.exists():
                ignore.write_text("*\n", encoding="utf-8")
            file = folder / f"{model.name}-{variant.name}"
            write_arrays(file, {_BLOB: np.frombuffer(compiled.blob, np.uint8)}, metadata)
        except (OSError, VaporTrackError):
            continue
        _remove_invalid(file)
        return True
    return False


def can_be_kept(model: Path) -> bool:
    """Whether compiled networks of a model file can be kept anywhere, as far as that is known in advance."""
    return any(os.access(_nearest(folder), os.W_OK) for folder in _folders(model))


def _folders(model: Path) -> tuple[Path, Path]:
    """Where compiled networks of a model may be: beside it, and in the user's cache by where the model is."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return _beside(model), cache / "vapor-track" / _digest(str(model.parent.resolve()))


def _beside(model: Path) -> Path:
    return model.parent / CACHE


def _nearest(folder: Path) -> Path:
    """The folder, or the first of those above it that exists."""
    return folder if folder.exists() else _nearest(folder.parent)


def _remove_invalid(file: Path) -> None:
    """Remove compiled networks of the same model file that are of another network or version."""
    valid, _, _ = file.name.rpartition("-")
    model, _, _ = valid.rpartition("-")
    for other in file.parent.glob("*"):
        named, _, _ = other.name.rpartition("-")
        if named != valid and named.rpartition("-")[0] == model:
            with suppress(OSError):
                other.unlink()


def _digest(*texts: str) -> str:
    return hashlib.sha256("\n".join(texts).encode()).hexdigest()[:12]
