"""Names that settings keep in files, where they had another one when files were first written with them."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

STORED_NAMES: Mapping[str, str] = MappingProxyType(
    {
        "ewta_fraction": "evolve",
        "ema_decay": "average",
        "validation_fraction": "validation_share",
        "store_float16": "half",
        "outlier_probability": "outlier_share",
        "possible_fraction": "possible_share",
        "lasting_fraction": "lasting_share",
        "constant_fraction": "constant_share",
        "converged_map_fraction": "converged_map_share",
    }
)
"""Setting -> its name in model files, states of trainings, `config.json` and `summary.json`."""

NAMES: Mapping[str, str] = MappingProxyType({stored: name for name, stored in STORED_NAMES.items()})
"""The other way round."""


def with_stored_names(values: Any) -> Any:
    """JSON whose objects, however deep, have their settings by the names of files."""
    if isinstance(values, Mapping):
        return {STORED_NAMES.get(name, name): with_stored_names(value) for name, value in values.items()}
    if isinstance(values, (list, tuple)):
        return [with_stored_names(value) for value in values]
    return values
