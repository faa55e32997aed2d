"""Put new files, or a new folder, in the place of earlier ones."""

from __future__ import annotations

import ctypes
import errno
import os
import shutil
from collections.abc import Collection, Iterable
from pathlib import Path

from sequences.atomic import NEW, move_in, workspace
from sequences.errors import SequenceError
from sequences.outputs.folders import foreign_files
from sequences.outputs.manifest import MANIFEST, own_manifest

_AT_FDCWD, _RENAME_EXCHANGE = -100, 2
_NOT_EXCHANGEABLE = {
    getattr(errno, name)
    for name in ("EXDEV", "EBUSY", "EPERM", "EACCES", "EINVAL", "ENOSYS", "ENOTSUP", "ENOTEMPTY", "EEXIST")
}


def is_exchangeable(directory: Path) -> bool:
    """Whether another folder may take the place of this one; what else forbids that shows when it is tried."""
    if not directory.exists():
        return True
    stays = os.path.ismount(directory) or Path.cwd().is_relative_to(directory.resolve())
    return not stays and os.access(directory.parent, os.W_OK | os.X_OK)


def replace_folder(work: Path, directory: Path, names: Collection[str], reads: Iterable[Path]) -> None:
    """Put the new folder in the place of an absent or empty one, or exchange it for one of results."""
    new = work / NEW
    try:
        if not directory.exists():
            os.rename(new, directory)
            return
        shutil.copymode(directory, new)
        if not any(directory.iterdir()):
            os.rename(new, directory)
            return
        if foreign_files(directory, reads):
            raise OSError(errno.ENOTEMPTY, "files were added meanwhile")
        exchange(new, directory)
    except OSError as error:
        if error.errno not in _NOT_EXCHANGEABLE or not directory.is_dir():
            raise
        with workspace(directory, directory.name) as inside:
            shutil.copytree(new, inside / NEW)
            replace_files(inside, names, reads)


def replace_files(work: Path, names: Collection[str], reads: Iterable[Path]) -> None:
    """Replace files one by one: those that the earlier manifest lists, and those of some names."""
    directory = work.parent
    manifest = own_manifest(directory)
    before = {} if manifest is None else manifest["files"] or {}
    read = {path.resolve() for path in reads}
    new = sorted(file.name for file in (work / NEW).iterdir() if file.name != MANIFEST)
    for name in new:
        file = directory / name
        if file.exists() and name not in names and not (name in before and before[name].is_of(file)):
            raise SequenceError(f"{file}: was written meanwhile, expected no other than the results")
    gone = [
        name
        for name, listed in before.items()
        if name not in new
        and (directory / name).exists()
        and listed.is_of(directory / name)
        and (directory / name).resolve() not in read
    ]
    first = [MANIFEST] if (directory / MANIFEST).exists() else []
    move_in(work, [*new, MANIFEST], instead_of=[*first, *gone])


def exchange(one: Path, other: Path) -> None:
    """Let two paths change places, as one.

    Raises:
        OSError: the system or file system cannot do that, or another error of it.
    """
    try:
        rename = ctypes.CDLL(None, use_errno=True).renameat2
    except (OSError, AttributeError) as error:
        raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS)) from error
    if rename(_AT_FDCWD, os.fsencode(one), _AT_FDCWD, os.fsencode(other), _RENAME_EXCHANGE) != 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))
