"""The same function over many jobs, in several processes of one thread each."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

from joblib import Parallel, delayed, parallel_config

Result = TypeVar("Result")


def in_parallel(function: Callable[..., Result], jobs: Iterable[tuple], workers: int) -> Iterator[Result]:
    """The result of `function(*job)` for every job, in no order, as each is done.

    A process takes seconds to start: no more are started than there are jobs, and for a single one none.
    """
    jobs = list(jobs)
    workers = max(1, min(workers, len(jobs)))
    with parallel_config(backend="loky", inner_max_num_threads=1):
        results = Parallel(n_jobs=workers, return_as="generator_unordered")(delayed(function)(*job) for job in jobs)
    yield from results  # pyright: ignore[reportReturnType]
