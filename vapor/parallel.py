"""One function over many jobs, in several processes of one thread each."""

from __future__ import annotations

import signal
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator
from multiprocessing import resource_tracker
from typing import TypeVar

from joblib import Parallel, delayed, parallel_config

Result = TypeVar("Result")


def in_parallel(function: Callable[..., Result], jobs: Iterable[tuple], workers: int) -> Iterator[Result]:
    """The result of `function(*job)` for every job, as each finishes, in no order.

    A process takes seconds to start: no more are started than there are jobs, and none for a single job.
    """
    jobs = list(jobs)
    workers = max(1, min(workers, len(jobs)))
    # Processes start with the signals blocked that are blocked here. A terminal sends its signals to all of them, but
    # this process answers and ends the others, each of which would die with a traceback.
    warnings.filterwarnings("ignore", r"\d+ tasks (which|have) ", UserWarning)  # left when it is interrupted
    resource_tracker.ensure_running()  # it unblocks SIGINT when it starts
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
    try:
        try:
            with parallel_config(backend="loky", inner_max_num_threads=1):
                parallel = Parallel(n_jobs=workers, return_as="generator_unordered")
                results = parallel(delayed(function)(*job) for job in jobs)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        yield from results  # pyright: ignore[reportReturnType]
    except KeyboardInterrupt:
        threading.excepthook = lambda _: None  # loky's thread may miss a worker that is starting
        raise
