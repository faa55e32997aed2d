"""Colours of pictures and viewer."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from vapor.tracking.methods import METHODS

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
