"""Output files that appear under their name only when they are complete; leftovers of killed processes are removed.

Files are not synced, so a power failure may lose or damage them. Nothing is written through mapped memory: a page for
which the disk has no room would kill the process.
"""

from __future__ import annotations

import fcntl
import itertools
import os
import re
import secrets
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from sequences.errors import SequenceError

_HIDDEN = re.compile(r"\..+\.[0-9a-f]{8}\.partial")
NEW = "new"
_REPLACED, _ADDED = "replaced", "added"


@contextmanager
def atomic_output(path: Path) -> Iterator[Path]:
    """Give a path to write to; it takes the place of `path` on success, and is removed on any error.

    Raises SequenceError where the folder is missing or cannot be written to, or the path is not one of a file.
    """
    path = Path(path)
    if not path.parent.is_dir():
        raise SequenceError(f"{path}: cannot write, expected the folder {path.parent} to exist")
    path = followed(path)
    if path.exists() and not path.is_file():
        raise SequenceError(f"{path}: cannot write: {'Is a directory' if path.is_dir() else 'not a regular file'}")
    try:
        with workspace(path.parent, path.name) as work:
            yield work / path.name
            os.replace(work / path.name, path)
    except OSError as error:
        raise SequenceError(f"{path}: cannot write: {error.strerror or error}") from error


def followed(path: Path) -> Path:
    """Where a path leads: itself, or the target of a link. Raises SequenceError where the link leads to nothing."""
    if path.is_symlink() and not path.exists():
        raise SequenceError(f"{path}: is a link to {os.readlink(path)}, which does not exist, expected it to")
    return path.resolve() if path.is_symlink() else path


@contextmanager
def workspace(place: Path, name: str) -> Iterator[Path]:
    """A hidden folder in `place` in which `name` is made; it is removed with all that is left in it.

    It is locked meanwhile. So folders of killed processes differ from those in use, and are removed first. Raises
    OSError where `place` cannot be written to.
    """
    clear_leftovers(place)
    work, lock = _locked_folder(place, name)
    try:
        yield work
    finally:
        with suppress(OSError):  # what cannot be removed now is a leftover
            _clear(work)
        os.close(lock)


def is_workspace(name: str) -> bool:
    """Whether a file or folder of this name is one that `workspace` made."""
    return _HIDDEN.fullmatch(name) is not None


def clear_leftovers(place: Path) -> None:
    """Remove what killed processes left in a folder; files that they were replacing there are put back."""
    try:
        hidden = [entry for entry in place.iterdir() if is_workspace(entry.name)]
    except OSError:
        return
    for leftover in hidden:
        with suppress(OSError):  # in use, or not ours to remove
            lock = os.open(leftover, os.O_RDONLY | os.O_NOFOLLOW)
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                _clear(leftover)
            finally:
                os.close(lock)


def move_in(work: Path, names: Iterable[str], *, instead_of: Iterable[str]) -> None:
    """Move files and folders of `work / NEW` one by one into the folder that a workspace lies in.

    If that fails or is interrupted, the workspace restores the earlier files; if the process is killed, the next that
    clears leftovers does.

    Args:
        work: The workspace.
        names: The files, all that are there; the last one completes them.
        instead_of: Files that go, the first of them before anything else changes.
    """
    folder, new, replaced, added = work.parent, work / NEW, work / _REPLACED, work / _ADDED
    added.mkdir()
    replaced.mkdir()
    number = itertools.count()
    for name in instead_of:
        os.rename(folder / name, replaced / f"{next(number):06d}.{name}")
    for name in names:
        if os.path.lexists(folder / name):
            os.rename(folder / name, replaced / f"{next(number):06d}.{name}")
        else:
            (added / name).touch()
        os.rename(new / name, folder / name)


def _clear(work: Path) -> None:
    # One of the folders is absent where a process was killed while it removed them: what had to be put back was.
    if all((work / folder).is_dir() for folder in (NEW, _ADDED, _REPLACED)) and any((work / NEW).iterdir()):
        _put_back(work)
    shutil.rmtree(work)


def _put_back(work: Path) -> None:
    """Undo `move_in` as far as it came; what it moved first goes back last."""
    for marker in (work / _ADDED).iterdir():
        if not (work / NEW / marker.name).exists():
            _remove(work.parent / marker.name)
    for file in sorted((work / _REPLACED).iterdir(), reverse=True):
        place = work.parent / file.name.partition(".")[2]
        if place.is_dir():  # the new one: a folder takes the place of no other
            _remove(place)
        os.rename(file, place)


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def _locked_folder(place: Path, name: str) -> tuple[Path, int]:
    while True:
        work = place / f".{name[:50]}.{secrets.token_hex(4)}.partial"
        work.mkdir()
        lock = -1
        try:
            lock = os.open(work, os.O_RDONLY)
            with suppress(OSError):  # where files cannot be locked, leftovers stay
                fcntl.flock(lock, fcntl.LOCK_EX)
            if os.path.samestat(os.fstat(lock), os.stat(work)):
                return work, lock
        except FileNotFoundError:  # another process took it for a leftover before it was locked
            pass
        if lock >= 0:
            os.close(lock)
