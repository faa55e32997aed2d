"""Where networks run."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from filtering.errors import VaporTrackError

if TYPE_CHECKING:
    import torch

Device = Literal["auto", "cpu", "cuda"]


def resolve_device(device: Device) -> torch.device:
    """The torch device of an option; "auto" is CUDA where there is one.

    Raises:
        VaporTrackError: CUDA asked for and absent.
    """
    import torch

    if device == "cuda" and not torch.cuda.is_available():
        raise VaporTrackError("device cuda: this torch finds no CUDA device, expected --device cpu or auto")
    return torch.device("cuda" if device != "cpu" and torch.cuda.is_available() else "cpu")
