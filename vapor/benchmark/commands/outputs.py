"""Folders of results that grow, and that may lie under a URL."""

from __future__ import annotations

import shutil
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

from filtering.errors import VaporTrackError
from sequences.outputs import MANIFEST, claim_folder, own_manifest, short_list
from vapor.benchmark import PROGRAM
from vapor.commands.console import path_given_by, path_or_url_to_write
from vapor.parallel.jobs import Workers
from vapor.storage import fetched, listed, published, url_of

SharedOutputPath = Annotated[Path, path_given_by(path_or_url_to_write)]
"""A path or a URL to write to, which is not empty; of a URL it is the path of the copy."""


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
                expected = f"expected an empty folder or one of `{PROGRAM} {command}`"
                raise VaporTrackError(f"{url}: {short_list(names)}, {expected}; --overwrite uses it all the same")
            shutil.rmtree(directory, ignore_errors=True)  # of what is no longer there
    claim_folder(directory, f"{PROGRAM} {command}", reads=reads, overwrite=overwrite)
    workers.require_to_see(directory)
    published(directory / MANIFEST)


def publish_results(directory: Path) -> None:
    """Write what a command found, which lies in a folder itself, to the folder's URL where it has one."""
    for file in sorted(directory.iterdir()) if url_of(directory) is not None else ():
        if file.is_file():
            published(file)
