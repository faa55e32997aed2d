"""Colours, small JPEGs, and figures without a window as PNG files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float64, Int64, UInt8

from filtering.plots import OTHER, TRUTH
from sequences.atomic import atomic_output
from vapor.tracking.methods import METHODS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLORS: Mapping[str, str] = MappingProxyType(
    {
        **{name: method.color for name, method in METHODS.items()},
        "truth": TRUTH,
        "other": OTHER,
    }
)
"""One colour in every picture for each tracking method, for the truth and for other hypotheses."""
INK = "#333333"
"""Of text and marks."""
FAINT = "#b8b8b8"
"""Of axes."""
_SOFTWARE = "vapor-track"  # the `Software` of a PNG


def rgb(code: str) -> tuple[int, int, int]:
    """A colour such as #0072b2, each part from 0 to 255."""
    return int(code[1:3], 16), int(code[3:5], 16), int(code[5:7], 16)


def jumps(positions: Float64[np.ndarray, "n 3"]) -> Int64[np.ndarray, " k"]:
    """Indices of the positions (metres) that are much farther from the one before than is usual on the path."""
    step = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    if len(step) == 0:
        return np.zeros(0, np.int64)
    return np.flatnonzero(step > 0.4 + 6.0 * np.median(step)) + 1


def shrunk(image: UInt8[np.ndarray, "height width 3"], side: int) -> UInt8[np.ndarray, "h w 3"]:
    """An image whose longer side has at most `side` pixels; an empty one stays empty."""
    import cv2

    height, width = image.shape[:2]
    if image.size == 0 or max(height, width) <= side:
        return image
    scale = side / max(height, width)
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


def as_jpeg(image: UInt8[np.ndarray, "h w 3"], quality: int) -> bytes:
    """An RGB image as a JPEG file of a quality from 0 to 100."""
    import cv2

    _, jpeg = cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, quality])
    return jpeg.tobytes()


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
