"""Colours, and figures without a window as PNG files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

from sequences.atomic import atomic_output
from vapor.tracking.methods import METHODS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLORS: Mapping[str, str] = MappingProxyType(
    {
        **{name: method.color for name, method in METHODS.items()},
        "truth": "#222222",
        "other": "#d55e00",  # hypotheses beside the best one
        "converged": "#cfdde6",
        "ambiguous": "#f0c8a0",
        "lost": "#b5423a",
    }
)
"""One colour in every picture for each tracking method, for the truth, for other hypotheses, and for each status."""

INK = "#333333"
"""Of text and marks."""

FAINT = "#b8b8b8"
"""Of axes."""


_SOFTWARE = "vapor-track"  # as a PNG says that made it


def new_figure(width: float, height: float) -> Figure:
    """An empty figure of so many inches, drawn without a window."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), dpi=120, layout="constrained", facecolor="white")


def save_figure(figure: Figure, path: Path) -> Path:
    """Write a PNG, the same bytes for the same figure; it appears under its name only when complete."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    with atomic_output(path) as partial:
        # `savefig` would draw everything twice, and pack twice as long for a tenth of the bytes.
        canvas = FigureCanvasAgg(figure)
        canvas.print_png(partial, metadata={"Software": _SOFTWARE}, pil_kwargs={"compress_level": 3})
    return path


def is_picture(path: Path) -> bool:
    """Whether a file is a PNG that `save_figure` wrote."""
    with path.open("rb") as file:
        return b"tEXtSoftware\0" + _SOFTWARE.encode() in file.read(1000)
