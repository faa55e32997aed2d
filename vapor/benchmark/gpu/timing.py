"""Times of work on a device, which is waited for."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import torch

from vapor.benchmark.gpu.stages import Deadline, Finding, OutOfTime

_WARM_UP = 5  # calls that are not counted: libraries choose their kernels, and a GPU its clock
_FEWEST = 5  # of which percentiles are given


def wait_for(device: torch.device) -> None:
    """Wait until a device has done all that it was given; processors have."""
    if device.type == "cuda":
        torch.cuda.synchronize()


def timed(
    what: str, call: Callable[[], object], device: torch.device, deadline: Deadline, *, repetitions: int, note: str = ""
) -> Finding:
    """Wall-clock time of a call until the device has done it, milliseconds; fewer repetitions where time is short.

    Raises:
        OutOfTime: there was time for hardly any.
    """
    for _ in range(_WARM_UP):
        call()
        deadline.check()
    wait_for(device)
    durations_ms: list[float] = []
    while len(durations_ms) < repetitions and deadline.left_s > 0.0:
        begin = time.perf_counter()
        call()
        wait_for(device)
        durations_ms.append(1e3 * (time.perf_counter() - begin))
    if len(durations_ms) < min(_FEWEST, repetitions):
        raise OutOfTime
    median, p95 = map(float, np.percentile(durations_ms, [50, 95]))
    counted = f"{len(durations_ms)} times"
    return Finding(what, median, "ms", p95=p95, note=f"{note}, {counted}" if note else counted)
