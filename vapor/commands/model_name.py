"""The option that names a model."""

from __future__ import annotations

from typing import Annotated

import tyro

from vapor.checkpoints.file_format import shipped_models

ModelName = Annotated[str, tyro.conf.arg(metavar=f"{{{','.join(shipped_models())}}}|PATH")]
"""A model that ships, by its name, or a model file."""
