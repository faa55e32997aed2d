"""When the state of a training is written and read, and how several processes come to share it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from time import perf_counter
from typing import Any

import torch

from vapor.training.processes import from_first, num_processes
from vapor.training.state import TrainingState, load_state, save_state

_SELDOM = 50.0  # times as long as the last one took, at least, from one saving to the next


class Saving:
    """Saves a training's state after its epochs, but where these are short not after each: that would slow it down.

    Args:
        path: From `state_path`.
        identity: JSON that must be equal for a training to be the same.
    """

    def __init__(self, path: Path, identity: Mapping[str, Any]) -> None:
        self._path, self._identity = path, identity
        self._next_s = 0.0

    def resume(self, state: TrainingState) -> None:
        """Fill a fresh state from the file, if there is one."""
        if self._path.exists():
            load_state(self._path, state, self._identity)

    def save(self, state: TrainingState, *, last: bool = False) -> None:
        """Write the state between two epochs; always the first one, and the last before something that takes long."""
        begin_s = perf_counter()
        if last or begin_s >= self._next_s:
            save_state(self._path, state, self._identity)
            end_s = perf_counter()
            self._next_s = end_s + _SELDOM * (end_s - begin_s)

    def remove(self) -> None:
        """Remove the file of a training that is finished."""
        self._path.unlink(missing_ok=True)


def share_state(state: TrainingState) -> None:
    """Give the first process' weights, moments and epochs to all others, in place."""
    if num_processes() == 1:
        return
    parts = state.network, state.average, state.optimizer
    values = from_first([_on_cpu(part.state_dict()) for part in parts])
    for part, value in zip(parts, values, strict=True):
        part.load_state_dict(value)
    state.epochs, state.epoch, state.seconds = from_first((state.epochs, state.epoch, state.seconds))


def _on_cpu(values: Any) -> Any:
    """A state's tensors on the CPU, in their memory layout: another process has another GPU."""
    if isinstance(values, torch.Tensor):
        return values.detach().cpu()
    if isinstance(values, dict):
        return {name: _on_cpu(value) for name, value in values.items()}
    return [_on_cpu(value) for value in values] if isinstance(values, list) else values
