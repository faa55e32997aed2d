"""One function over many jobs, wherever they are done."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from vapor.parallel.cluster import Cluster
from vapor.parallel.processes import in_processes
from vapor.storage import url_of

Result = TypeVar("Result")


@dataclass(frozen=True)
class Workers:
    """Where jobs are done.

    Attributes:
        processes: So many processes of this machine, each with one thread.
        cluster: The workers of a scheduler, instead of them.
        tell: Called with a line on what a person should know, such as that a worker died.
    """

    processes: int = 1
    cluster: Cluster | None = None
    tell: Callable[[str], None] = field(default=lambda line: None, compare=False)

    @property
    def are_this_process(self) -> bool:
        """Whether jobs are done one after the other where they are asked for."""
        return self.cluster is None and self.processes == 1

    def require_to_see(self, folder: Path) -> None:
        """Check that a folder here is there for all workers, unless they reach it by a URL.

        Raises:
            ClusterError: it is not; names a worker.
        """
        if self.cluster is not None and url_of(folder) is None:
            self.cluster.require_to_see(folder)


def in_parallel(function: Callable[..., Result], jobs: Iterable[tuple], workers: Workers) -> Iterator[Result]:
    """The result of `function(*job)` for every job, as each finishes, in no order.

    Jobs whose worker dies are done again, twice at most here, and as often as its scheduler allows on a cluster. So a
    job must come to the same where it was begun before.

    Raises:
        TerminatedWorkerError: processes of this machine died again and again.
        VaporTrackError: what a job raised, or on a cluster what `Cluster.results` says.
    """
    if workers.cluster is not None:
        yield from workers.cluster.results(function, list(jobs))
    else:
        yield from in_processes(function, list(jobs), workers.processes, workers.tell)
