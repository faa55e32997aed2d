"""One function over many jobs: in processes of this machine, or on the workers of a cluster."""

from __future__ import annotations

import signal
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from multiprocessing import resource_tracker
from pathlib import Path
from typing import TypeVar

from joblib import Parallel, delayed, parallel_config
from joblib.externals.loky.process_executor import TerminatedWorkerError

from vapor.parallel.cluster import Cluster
from vapor.storage import url_of

Result = TypeVar("Result")

_TRIES = 3


def in_processes(
    function: Callable[..., Result], jobs: Sequence[tuple], processes: int, notify: Callable[[str], None]
) -> Iterator[Result]:
    """The result of `function(*job)` for every job, as each finishes, in no order.

    A process takes seconds to start: there are no more than jobs, and none for a single job or a single process. One
    that dies takes the others with it: unfinished jobs are then begun again.

    Raises:
        TerminatedWorkerError: that happened three times.
    """
    if min(processes, len(jobs)) < 2:
        yield from (function(*job) for job in jobs)
        return
    left = dict(enumerate(jobs))
    for tried in range(1, _TRIES + 1):
        try:
            for number, result in _batch(function, left, min(processes, len(jobs))):
                del left[number]
                yield result
            return
        except TerminatedWorkerError:
            if tried == _TRIES:
                raise
            again = f"{len(left)} of {len(jobs)} jobs are begun again"
            notify(f"a worker process ended unexpectedly, perhaps for lack of memory; {again}")


def _batch(function: Callable[..., Result], jobs: Mapping[int, tuple], processes: int) -> Iterator[tuple[int, Result]]:
    # Processes start with the signals blocked that are blocked here. A terminal sends its signals to all of them, but
    # this process answers and ends the others, each of which would die with a traceback.
    warnings.filterwarnings("ignore", r"\d+ tasks (which|have) ", UserWarning)  # left when it is interrupted
    resource_tracker.ensure_running()  # it unblocks SIGINT when it starts
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


Result = TypeVar("Result")


@dataclass(frozen=True)
class Workers:
    """Processes of this machine, each with one thread, or the workers of a scheduler instead.

    `notify` is called with a line such as that a worker died.
    """

    processes: int = 1
    cluster: Cluster | None = None
    notify: Callable[[str], None] = field(default=lambda line: None, compare=False)

    @property
    def are_this_process(self) -> bool:
        """Whether jobs are done one after the other in this process."""
        return self.cluster is None and self.processes == 1

    def require_to_see(self, folder: Path) -> None:
        """Raise ClusterError where a worker does not see a folder, unless it has a URL."""
        if self.cluster is not None and url_of(folder) is None:
            self.cluster.require_to_see(folder)


def in_parallel(function: Callable[..., Result], jobs: Iterable[tuple], workers: Workers) -> Iterator[Result]:
    """The result of `function(*job)` for every job, as each finishes, in no order.

    Jobs whose worker dies are done again, twice at most here, and as often as its scheduler allows on a cluster. So the
    result of a job may not depend on whether it was begun before.

    Raises:
        TerminatedWorkerError: processes of this machine died again and again.
        VaporTrackError: of a job, or on a cluster those of `Cluster.results`.
    """
    if workers.cluster is not None:
        yield from workers.cluster.results(function, list(jobs))
    else:
        yield from in_processes(function, list(jobs), workers.processes, workers.notify)
