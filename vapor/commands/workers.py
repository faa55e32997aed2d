"""The workers of commands with many jobs."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Annotated

import tyro

from vapor.commands.terminal import write_error
from vapor.parallel.cluster import connected
from vapor.parallel.jobs import Workers

Scheduler = Annotated[
    str | None,
    tyro.conf.arg(
        metavar="ADDRESS",
        help="Of a Dask scheduler, such as tcp://host:8786: its workers do the work, instead of processes here.",
    ),
]
"""Option: a scheduler whose workers do the jobs."""


@contextmanager
def workers_for(command: str, processes: int, scheduler: str | None, program: str = "vapor-track") -> Iterator[Workers]:
    """So many processes here, or the workers of a scheduler; their messages are printed on standard error."""

    def notify(line: str) -> None:
        write_error(f"{program} {command}: {line}")

    if scheduler is None:
        yield Workers(processes, notify=notify)
        return
    hush_dask()
    with connected(scheduler, notify) as cluster:
        seen = f"dashboard {cluster.dashboard}" if cluster.dashboard else "no dashboard"
        waiting = "" if cluster.size else "; waits for the first"
        notify(f"{scheduler} has {cluster.size} worker{'s' * (cluster.size != 1)}{waiting}, {seen}")
        yield Workers(processes, cluster, notify)


def hush_dask() -> None:
    """Let Dask log nothing."""
    with suppress(ImportError):
        import distributed  # noqa: F401  # makes its loggers

    for name in [name for name in logging.root.manager.loggerDict if name.startswith("distributed")]:
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)
