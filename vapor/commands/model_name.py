"""The option that names a model."""

from __future__ import annotations

from typing import Annotated

import tyro

from vapor.checkpoints.file_format import shipped_models


def _name(words: list[str]) -> str:
    if not words[0].strip():
        raise ValueError("is empty, expected a model")
    return words[0]


ModelName = Annotated[
    str,
    tyro.constructors.PrimitiveConstructorSpec(
        nargs=1,
        metavar=f"{{{','.join(shipped_models())}}}|PATH",
        instance_from_str=_name,
        is_instance=lambda value: isinstance(value, str),
        str_from_instance=lambda name: [name],
    ),
]
"""A model that ships, by its name, or a model file."""
