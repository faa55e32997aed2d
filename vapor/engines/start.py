"""The choice of the engine that runs a network, as asked for or the faster installed one; and its start."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from filtering.errors import VaporTrackError
from vapor.checkpoints.checkpoint import Checkpoint, ModelDescription
from vapor.checkpoints.file_format import is_onnx, load_checkpoint, load_description
from vapor.engines import openvino_engine
from vapor.engines.engine import Device, Engine, EngineConfig, Precision
from vapor.engines.onnx_file import describe_onnx
from vapor.engines.openvino_engine import Compiled, KeptNetwork, can_be_kept
from vapor.threads import limited_threads

_SAMPLES = 1000  # with which engines are timed
_TIMED = 5  # times, after one that is not counted; the least counts: the machine may be busy


def describe(file: Path) -> ModelDescription:
    """A model without its weights, from a model file or an exported one; torch is not imported.

    Raises:
        CheckpointError: no such file, or one that cannot be used.
    """
    return describe_onnx(file) if is_onnx(file) else load_description(file)


def start_engine(
    model: Checkpoint | ModelDescription,
    config: EngineConfig = EngineConfig(),
    *,
    device: Device = "auto",
    threads: int = 1,
) -> Engine:
    """The engine of a model, whose weights are read only where the engine has not kept the compiled network.

    "auto" takes OpenVINO on a processor where it is installed and was faster than torch when the network was compiled.
    That finding is kept with the compiled network, so that a model runs the same way every time; where nothing can be
    kept, torch is taken. `threads` is for OpenVINO; torch's threads are set by `limited_threads`.

    Raises:
        VaporTrackError: an engine that is not installed, or does not go with the device, the precision or the model.
    """
    file = model.file
    exported = file is not None and is_onnx(file)
    asked = _asked(config, device, file if exported else None)
    if asked == "torch" or (asked == "auto" and not (file and can_be_kept() and openvino_engine.is_installed())):
        return _torch(model, config.precision, device)
    openvino_engine.require_installed()
    if config.precision == "bfloat16":
        openvino_engine.require_bfloat16()
    return _openvino(model, config, exported=exported, threads=threads, must=asked == "openvino")


def _asked(config: EngineConfig, device: Device, exported: Path | None) -> str:
    """torch, openvino, or auto where both will do."""
    if exported is not None or config.engine == "openvino":
        if config.engine == "torch" or device == "cuda":
            what = "engine openvino" if exported is None else f"{exported}: an exported model"
            other = "engine torch" if config.engine == "torch" else "device cuda"
            raise VaporTrackError(f"{what} with {other}, expected engine openvino on a processor")
        return "openvino"
    if config.engine == "torch" or device == "cuda" or (device == "auto" and _has_cuda()):
        return "torch"
    return "openvino" if config.precision == "bfloat16" else "auto"


def _has_cuda() -> bool:
    """Whether torch finds a GPU; torch is not loaded where the system has none."""
    if not any(any(Path("/dev").glob(name)) for name in ("nvidia*", "dxg")):
        return False
    import torch

    return torch.cuda.is_available()


def _torch(model: Checkpoint | ModelDescription, precision: Precision, device: Device) -> Engine:
    from vapor.engines.torch_engine import TorchEngine

    return TorchEngine(_with_weights(model), device=device, precision=precision)


def _with_weights(model: Checkpoint | ModelDescription) -> Checkpoint:
    if isinstance(model, Checkpoint):
        return model
    if model.file is None:
        raise VaporTrackError("a model without weights and without a file, expected either")
    return load_checkpoint(model.file)


def _openvino(
    model: Checkpoint | ModelDescription, config: EngineConfig, *, exported: bool, threads: int, must: bool
) -> Engine:
    """OpenVINO's engine as kept, or compiled and kept; torch's where that was faster and is allowed."""
    described, precision = model if isinstance(model, ModelDescription) else model.description, config.precision
    place = None if described.file is None else KeptNetwork(described, precision)
    kept = None if place is None else place.read()
    if kept is not None and not must and not kept.faster:
        return _torch(model, precision, "cpu")
    if kept is not None:
        try:
            return openvino_engine.OpenVINOEngine(openvino_engine.compiled_network(kept.blob, precision, threads))
        except RuntimeError:  # OpenVINO raises it for a network of another build: it is compiled again
            pass
    network, torch = described.file, None
    if not exported:
        checkpoint = _with_weights(model)
        network = openvino_engine.converted_network(checkpoint)
        torch = _torch(checkpoint, "float32", "cpu")
    try:
        compiled = openvino_engine.compile_network(network, precision, threads)
    except RuntimeError as error:  # as on a processor without arithmetic of the precision
        if torch is not None and not must:
            return torch
        expected = "the exported file as it was written" if exported else "--engine torch"
        raise VaporTrackError(
            f"{described.file or 'engine openvino'}: OpenVINO cannot compile the network in {precision}"
            f" ({openvino_engine.last_line(error)}), expected {expected}"
        ) from error
    if exported:
        openvino_engine.require_ports(compiled, described)
    engine = openvino_engine.OpenVINOEngine(compiled)
    faster = None if torch is None else _is_faster(engine, torch, described, threads)
    is_kept = place is not None and place.write(Compiled(compiled.export_model().getvalue(), faster))
    if torch is not None and not must and not (faster and is_kept):
        return torch
    return engine


def _is_faster(engine: Engine, than: Engine, described: ModelDescription, threads: int) -> bool:
    """Whether an engine takes less time for an image than another; they take turns."""
    rng, size = np.random.default_rng(0), described.network
    image = rng.integers(0, 256, (size.image_height, size.image_width, 3), dtype=np.uint8)
    least = dict.fromkeys((engine, than), np.inf)
    with limited_threads(threads):
        for timed in range(_TIMED + 1):
            for each in least:
                noise = rng.standard_normal((_SAMPLES, each.noise_dim), dtype=np.float32)
                begin = time.perf_counter()
                each.run(image, noise)
                if timed:
                    least[each] = min(least[each], time.perf_counter() - begin)
    return least[engine] < least[than]
