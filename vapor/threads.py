"""How many processor threads the arithmetic may use."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from threadpoolctl import threadpool_limits


@contextmanager
def limited_threads(network: int) -> Iterator[None]:
    """Limit the network to `network` threads, and linear algebra to one, inside a `with` block.

    The filter's matrix products take well under a millisecond: threads that wait for each other gain nothing, and on
    a shared processor they made a step ten times slower.
    """
    import torch  # here: results that are found again need none of it

    before = torch.get_num_threads()
    torch.set_num_threads(network)
    try:
        with threadpool_limits(1, user_api="blas"):
            yield
    finally:
        torch.set_num_threads(before)
