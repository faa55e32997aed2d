"""The option that names a model."""

from __future__ import annotations

from typing import Annotated

import tyro

from vapor.checkpoints.file_format import shipped_models

OF_MODEL = tyro.conf.arg(metavar=f"{{{','.join(shipped_models())}}}|PATH")
"""What stands for the value of such an option."""
ModelName = Annotated[str, OF_MODEL]
"""A model that ships, by its name, or a model file."""
