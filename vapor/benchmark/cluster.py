"""How much sooner many jobs are done by more nodes: delays in place of work, and what the scheduler takes for each."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from filtering.errors import VaporTrackError, require_within
from vapor.parallel.cluster import ClusterError, connected
from vapor.parallel.jobs import Workers, in_parallel


@dataclass(frozen=True)
class ClusterConfig:
    """Settings of the benchmark."""

    nodes: tuple[int, ...] = (1, 2, 4, 8)
    """Numbers of nodes, each a worker process on this machine."""
    jobs: int = 16
    """Jobs for each node."""
    seconds: float = 2.0
    """How long a job takes on average; a trial of `benchmark localization` takes about as long, others longer. Each
    takes half to one and a half times as long, at random."""
    empty_jobs: int = 1000
    """Jobs that take no time: they tell what the scheduler takes for one."""
    seed: int = 0
    """Of the jobs' lengths."""

    def __post_init__(self) -> None:
        counts = dict.fromkeys(("jobs", "empty_jobs"), (1, 10**6))
        require_within(self, seconds=(0.01, 3600.0), seed=(0, 10**9), **counts)
        if not self.nodes or not all(1 <= number <= 1000 for number in self.nodes):
            raise VaporTrackError(f"nodes are {self.nodes}, expected numbers from 1 to 1000")


@dataclass(frozen=True)
class Scaling:
    """What some nodes did.

    Attributes:
        nodes: How many.
        work_s: How long their jobs take one after the other.
        wall_s: How long they took.
        scheduling_s: Processor time of the scheduler, and of the process that asks it, for a job.
    """

    nodes: int
    work_s: float
    wall_s: float
    scheduling_s: float

    @property
    def speed_up(self) -> float:
        """How many jobs were done at a time."""
        return self.work_s / self.wall_s

    @property
    def efficiency(self) -> float:
        """The fraction of their time in which nodes worked."""
        return self.speed_up / self.nodes

    def efficiency_of(self, nodes: int, job_s: float) -> float:
        """At most, with so many nodes whose jobs take so long: those that the scheduler can keep at work."""
        return min(1.0, job_s / (nodes * self.scheduling_s))


def measure(config: ClusterConfig) -> Iterator[Scaling]:
    """For each number of nodes, one after the other.

    Raises:
        ClusterError: Dask is not installed.
    """
    try:
        from distributed import LocalCluster
    except ImportError as error:
        raise ClusterError("benchmark cluster needs Dask: pip install 'vapor-track[cluster]'") from error
    rng = np.random.default_rng(config.seed)
    for nodes in config.nodes:
        lengths_s = config.seconds * rng.uniform(0.5, 1.5, config.jobs * nodes)
        local: Any = LocalCluster(n_workers=nodes, threads_per_worker=1, dashboard_address=":0")
        with local, connected(local.scheduler_address, lambda line: None) as cluster:
            workers = Workers(cluster=cluster)
            _time([0.0] * (10 * nodes), workers)  # the first job of a worker imports what it needs
            _, scheduling_s = _time([0.0] * config.empty_jobs, workers)
            wall_s, _ = _time(lengths_s, workers)
        yield Scaling(nodes, float(np.sum(lengths_s)), wall_s, scheduling_s / config.empty_jobs)


def _time(lengths_s: np.ndarray | list[float], workers: Workers) -> tuple[float, float]:
    """Seconds until all is done, and of this process's own work, which is the scheduler's as well."""
    begin_s, begin_own_s = time.perf_counter(), time.process_time()
    for _ in in_parallel(time.sleep, [(float(length_s),) for length_s in lengths_s], workers):
        pass
    return time.perf_counter() - begin_s, time.process_time() - begin_own_s
