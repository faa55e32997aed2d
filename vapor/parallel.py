"""One function over many jobs, in processes of this machine or of others."""

from __future__ import annotations

import logging
import signal
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from multiprocessing import resource_tracker
from typing import TypeVar

from vapor.cluster import on_cluster

Result = TypeVar("Result")

_TRIES = 3


def in_parallel(
    function: Callable[..., Result],
    jobs: Iterable[tuple],
    processes: int,
    *,
    scheduler: str | None = None,
    given_up: Callable[..., Result] | None = None,
) -> Iterator[tuple[int, Result]]:
    """The number of every job, and the result of `function(*job)`, as each finishes, in no order.

    A process takes seconds to start: there are no more than jobs, and none for a single job or a single process. One
    that dies takes the others with it: unfinished jobs are then begun again, and a warning is logged. So the result of
    a job may not depend on whether it was begun before.

    Args:
        function: What every job does; it can be pickled.
        jobs: Arguments of each.
        processes: How many at a time on this machine, each with one thread.
        scheduler: Of Dask: the jobs are done by its workers instead, see `on_cluster`. One that dies takes no others
            with it.
        given_up: The result of a job, by its arguments, whose workers of a scheduler died each time; None to raise.

    Raises:
        TerminatedWorkerError: processes died three times.
        VaporTrackError: the scheduler or its workers cannot be used.
    """
    left = dict(enumerate(jobs))
    total = len(left)
    if scheduler is not None:
        yield from on_cluster(function, left, scheduler, given_up)
        return
    if min(processes, total) < 2:
        yield from ((number, function(*job)) for number, job in left.items())
        return
    from joblib.externals.loky.process_executor import TerminatedWorkerError  # a single process needs no joblib

    for tried in range(1, _TRIES + 1):
        try:
            for number, result in _batch(function, left, min(processes, total)):
                del left[number]
                yield number, result
            return
        except TerminatedWorkerError:
            if tried == _TRIES:
                raise
            logging.getLogger(__name__).warning(
                "a worker process ended unexpectedly, perhaps for lack of memory; %d of %d jobs are begun again",
                len(left),
                total,
            )


def _batch(function: Callable[..., Result], jobs: Mapping[int, tuple], processes: int) -> Iterator[tuple[int, Result]]:
    from joblib import Parallel, delayed, parallel_config
    from joblib.externals.loky.backend import resource_tracker as loky_tracker

    # Processes start with the signals blocked that are blocked here. A terminal sends its signals to all of them, but
    # this process answers and ends the others, each of which would die with a traceback.
    warnings.filterwarnings("ignore", r"\d+ tasks (which|have) ", UserWarning)  # left when it is interrupted
    for tracker in (resource_tracker, loky_tracker):  # each unblocks SIGINT when it starts
        tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
    try:
        try:
            with parallel_config(backend="loky", inner_max_num_threads=1):
                parallel = Parallel(n_jobs=processes, return_as="generator_unordered")
                results = parallel(delayed(_numbered)(function, number, job) for number, job in [*jobs.items()])
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        yield from results  # pyright: ignore[reportReturnType]
    except KeyboardInterrupt:
        threading.excepthook = lambda _: None  # loky's thread may miss a worker that is starting
        raise


def _numbered(function: Callable[..., Result], number: int, job: tuple) -> tuple[int, Result]:
    return number, function(*job)
