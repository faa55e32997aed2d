"""A trained model -> one ONNX file, for robots without torch (docs/export.md); checked before it is there."""

from __future__ import annotations

import io
import warnings
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from filtering.errors import VaporTrackError
from filtering.se3 import Poses
from sequences.atomic import atomic_output
from vapor.checkpoints.checkpoint import Checkpoint
from vapor.engines.onnx_file import add_description

if TYPE_CHECKING:
    from vapor.engines.torch_engine import WholeNetwork

INPUTS = "image", "noise"
OUTPUTS = "translation", "rotation", "description"
"""Names of inputs and outputs; the last one is there for a model with an OOD model."""
WITHIN_M, WITHIN_RAD = 1e-4, 1e-4
"""How far poses of an exported network may be from torch's."""
_OPSET = 17
_CHECKED = 200  # posterior samples, other than the network was traced with


def export_onnx(checkpoint: Checkpoint, output: Path) -> tuple[float, float]:
    """Write a model as an ONNX file, complete or not at all, once it gave the poses that torch gives.

    Returns:
        The largest differences of positions in metres and of rotations in radians, by onnxruntime.

    Raises:
        VaporTrackError: a package is missing, the network cannot be exported, its poses differ by more than `WITHIN_M`
            or `WITHIN_RAD`, or the file cannot be written.
    """
    from vapor.engines.torch_engine import WholeNetwork

    if missing := [name for name in ("onnx", "onnxruntime") if find_spec(name) is None]:
        raise VaporTrackError(f"export: {missing[0]} is not installed, expected it: pip install 'vapor-track[export]'")
    whole = WholeNetwork(checkpoint).eval()
    with atomic_output(output) as partial:
        _write(whole, partial)
        add_description(partial, checkpoint.description)
        metres, radians = _difference(whole, partial)
        if not (metres <= WITHIN_M and radians <= WITHIN_RAD):  # NaN compares as false
            raise VaporTrackError(
                f"{output}: onnxruntime gives poses up to {metres:.2g} m and {radians:.2g} rad from torch's, expected"
                f" {WITHIN_M:g} m and {WITHIN_RAD:g} rad at most: not written"
            )
    return metres, radians


def _write(whole: WholeNetwork, path: Path) -> None:
    import torch

    from vapor.engines.torch_engine import traced_inputs

    inputs, graph = traced_inputs(whole), io.BytesIO()
    outputs = OUTPUTS if whole.described else OUTPUTS[:2]
    try:
        with torch.no_grad(), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # that Python numbers become constants, and that there is a newer exporter
            torch.onnx.export(
                whole,
                inputs,
                graph,  # pyright: ignore[reportArgumentType]  # to a path it could write names in UTF-8 only
                dynamo=False,  # the newer one takes ten times as long, and bakes in the number of samples
                input_names=list(INPUTS),
                output_names=list(outputs),
                dynamic_axes={name: {0: "m"} for name in ("noise", "translation", "rotation")},
                opset_version=_OPSET,
            )
    except (RuntimeError, torch.onnx.OnnxExporterError) as error:  # e.g. an operation that ONNX has not
        head = whole.network.config.head
        reason = (str(error).strip().splitlines() or [type(error).__name__])[0]
        raise VaporTrackError(f"export: a network with head {head!r} cannot be exported ({reason})") from error
    path.write_bytes(graph.getbuffer())


def _difference(whole: WholeNetwork, path: Path) -> tuple[float, float]:
    """Largest differences between the poses of onnxruntime and of torch for one image and noise: metres and radians."""
    import torch

    from vapor.engines.torch_engine import traced_inputs

    image, noise = traced_inputs(whole, samples=_CHECKED)
    with torch.inference_mode():
        translation, rotation, *_ = whole(image, noise)
    found = _run(path, [image.numpy(), noise.numpy()])
    ours, theirs = (
        Poses(matrices.astype(np.float64), positions.astype(np.float64))
        for positions, matrices in ((translation.numpy(), rotation.numpy()), (found[0], found[1]))
    )
    metres, radians = ours.distance(theirs)
    return float(metres.max()), float(radians.max())


def _run(path: Path, inputs: Sequence[np.ndarray]) -> list[np.ndarray]:
    import onnxruntime

    session = onnxruntime.InferenceSession(path.read_bytes(), providers=["CPUExecutionProvider"])
    return [np.asarray(each) for each in session.run(None, dict(zip(INPUTS, inputs, strict=True)))]
