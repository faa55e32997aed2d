"""The folder of an output: where it is, what lies in it, and which files of that are not ours."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from sequences.atomic import CACHE, clear_leftovers, followed, is_workspace
from sequences.errors import SequenceError
from sequences.outputs.manifest import MANIFEST, own_manifest

_NAMED = 3  # files, in a message


@contextmanager
def writing(directory: Path) -> Iterator[None]:
    """Turn an OSError into a SequenceError that names the folder."""
    try:
        yield
    except OSError as error:
        raise SequenceError(
            f"{directory}: cannot write: {error.strerror or error}, expected a directory that can be written to"
        ) from error


def folder_to_write(directory: Path) -> Path:
    """The folder that an output leads to, absolute; what killed processes left there is cleared away.

    Raises:
        SequenceError: it is a file, or a link that leads to nothing.
    """
    folder = followed(directory).absolute()
    if folder.exists() and not folder.is_dir():
        raise SequenceError(f"{directory}: is a file, expected a directory to write the results to")
    clear_leftovers(folder)
    return folder


def foreign_files(directory: Path, reads: Iterable[Path]) -> dict[str, str]:
    """What a folder holds beside the results that its manifest lists, by name: how to tell of it.

    What a command reads is never a result.
    """
    if not directory.is_dir():
        return {}
    manifest = own_manifest(directory)
    listed = {} if manifest is None else manifest["files"] or {}
    read = {path.resolve() for path in reads}
    foreign: dict[str, str] = {}
    for entry in sorted(directory.iterdir()):
        name, ours = entry.name, listed.get(entry.name)
        if is_workspace(name) or name == CACHE or (name == MANIFEST and listed):
            continue
        if entry.resolve() in read:
            foreign[name] = f"{name} (which is read)"
        elif ours is None:
            foreign[name] = name
        elif not ours.is_of(entry):
            foreign[name] = f"{name} (changed)"
    return foreign


def names_told(names: Sequence[str]) -> str:
    """Up to three names, and how many more there are."""
    short = [name if len(name) <= 40 else f"{name[:39]}…" for name in names[:_NAMED]]
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return f"holds {', '.join(short)}{more}"
