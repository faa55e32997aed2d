"""`vapor-track export`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import tyro

from filtering.errors import quoted
from sequences.outputs import refuse_other
from vapor.checkpoints.file_format import ONNX, find_model, is_onnx, load_checkpoint
from vapor.commands.console import OutputPath, Overwrite, parse, show, usage_error
from vapor.commands.model_name import ModelName
from vapor.engines.onnx_export import export_onnx
from vapor.engines.onnx_file import is_exported


@dataclass(frozen=True)
class Options:
    """Write a trained model as an ONNX file, checked against torch; docs/export.md lists its inputs and outputs."""

    model: tyro.conf.Positional[ModelName]
    """Name of a model that ships with the package, or model file."""
    output: Annotated[tyro.conf.Positional[OutputPath], tyro.conf.arg(metavar="OUT.onnx")]
    """ONNX file to write, new or exported before."""
    overwrite: Overwrite = False


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    o = parse("export", Options, arguments)
    if not is_onnx(o.output):
        usage_error("export", f"OUT.onnx is {quoted(str(o.output))}, expected a name that ends in {ONNX}")
    file = find_model(o.model)
    refuse_other(o.output, "model that vapor-track exported", is_exported, reads=[file], overwrite=o.overwrite)
    metres, radians = export_onnx(load_checkpoint(file), o.output)
    size_mb = o.output.stat().st_size / 1e6
    show(f"{o.output}: {size_mb:.1f} MB; by onnxruntime within {metres:.1g} m and {radians:.1g} rad of torch")
