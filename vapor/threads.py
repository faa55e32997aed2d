"""Limits of processor threads."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from threadpoolctl import threadpool_limits

_limits: list[int] = []  # of the blocks that are open, the innermost last
_unlimited: list[int] = []  # how many threads torch had outside of them, once it is known


@contextmanager
def limited_threads(network: int) -> Iterator[None]:
    """Limit the network to `network` threads, and linear algebra to one, inside a `with` block.

    The filter's matrix products take well under a millisecond: on a shared processor, threads that wait for each other
    made a step ten times slower. Torch is not loaded here: code within the block that loads it calls `limit_torch`.
    """
    _limits.append(network)
    limit_torch()
    try:
        with threadpool_limits(1, user_api="blas"):
            yield
    finally:
        _limits.pop()
        if _unlimited:
            sys.modules["torch"].set_num_threads(_limits[-1] if _limits else _unlimited.pop())


def limit_torch() -> None:
    """Hold torch, where it is loaded, to the threads of the innermost `limited_threads`."""
    torch = sys.modules.get("torch")
    if torch is None or not _limits:
        return
    if not _unlimited:
        _unlimited.append(torch.get_num_threads())
    torch.set_num_threads(_limits[-1])
