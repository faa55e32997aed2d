"""What commands of many jobs share: where these are done, and results that may lie under a URL."""

from __future__ import annotations

import logging
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Annotated

import tyro

from filtering.errors import VaporTrackError
from sequences.outputs.claims import claim_folder
from sequences.outputs.folders import names_told
from sequences.outputs.manifest import MANIFEST, own_manifest
from vapor.commands.terminal import say
from vapor.parallel.cluster import connected
from vapor.parallel.jobs import Workers
from vapor.storage import fetched, listed, published, url_of

Scheduler = Annotated[
    str | None,
    tyro.conf.arg(
        metavar="ADDRESS",
        help="Of a Dask scheduler, such as tcp://host:8786: its workers do the work, instead of processes here.",
    ),
]
"""The option that says where jobs are done."""


@contextmanager
def workers_for(command: str, processes: int, scheduler: str | None) -> Iterator[Workers]:
    """So many processes here, or the workers of a scheduler; what they have to tell is printed on standard error."""

    def tell(line: str) -> None:
        say(f"vapor-track {command}: {line}")

    if scheduler is None:
        yield Workers(processes, tell=tell)
        return
    hush_dask()
    with connected(scheduler, tell) as cluster:
        seen = f"dashboard {cluster.dashboard}" if cluster.dashboard else "no dashboard"
        waiting = "" if cluster.size else "; waits for the first"
        tell(f"{scheduler} has {cluster.size} worker{'s' * (cluster.size != 1)}{waiting}, {seen}")
        yield Workers(processes, cluster, tell)


def hush_dask() -> None:
    """Let Dask log nothing: what matters is told in one line."""
    with suppress(ImportError):
        import distributed  # noqa: F401  # makes its loggers

    for name in [name for name in logging.root.manager.loggerDict if name.startswith("distributed")]:
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)


def claim_shared(
    directory: Path, command: str, workers: Workers, *, reads: Iterable[Path] = (), overwrite: bool = False
) -> None:
    """As `claim_folder`, of a folder that all workers see, or of the copy of what a URL stands for.

    Raises:
        VaporTrackError: as there, a worker does not see the folder, or the storage cannot be used.
    """
    if (url := url_of(directory)) is not None:
        names = sorted({file.relative_to(directory).parts[0] for file in listed(directory) if file != directory})
        fetched(directory / MANIFEST)
        if own_manifest(directory) is None:
            if names and not overwrite:
                expected = f"expected an empty folder or one of `vapor-track {command}`"
                raise VaporTrackError(f"{url}: {names_told(names)}, {expected}; --overwrite uses it all the same")
            shutil.rmtree(directory, ignore_errors=True)  # of what is no longer there
    claim_folder(directory, command, reads=reads, overwrite=overwrite)
    workers.require_to_see(directory)
    published(directory / MANIFEST)


def publish_results(directory: Path) -> None:
    """Write what a command found, which lies in a folder itself, to the folder's URL where it has one."""
    for file in sorted(directory.iterdir()) if url_of(directory) is not None else ():
        if file.is_file():
            published(file)
