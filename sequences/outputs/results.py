"""Folders of results: whole or not there, and only replaced by results.

A new folder is made beside its place and renamed. In one that is there files are replaced one by one, and the manifest
is gone meanwhile; what a killed process left half replaced is put back by the next that reads or writes there.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from sequences.atomic import NEW, move_in, workspace
from sequences.errors import SequenceError
from sequences.outputs.folders import folder_to_write, foreign_files, names_told, writing
from sequences.outputs.manifest import MANIFEST, Listed, own_manifest, write_manifest


@contextmanager
def results_folder(
    directory: Path, command: str, *, writes: Collection[str], reads: Iterable[Path] = (), overwrite: bool = False
) -> Iterator[Path]:
    """Give a hidden folder to write to; on success it takes the place of `directory`, with a manifest.

    Args:
        directory: Absent, empty or results; made with the folders above it. A link to a folder is followed.
        command: What writes it.
        writes: Names of all files that it may write.
        reads: Files and folders that it reads: they are never replaced, nor what lies in them but unchanged results.
        overwrite: Take any folder, and replace files of these names, and of an earlier manifest, only.

    Raises:
        SequenceError: the folder holds something else, is none, is or holds what is read, or cannot be written to.
            All but failing disks are found before anything is written.
    """
    reads = list(reads) if directory.exists() else []
    given, directory = directory, require_replaceable(directory, writes, reads, overwrite=overwrite)
    with ExitStack() as stack:
        with writing(given):
            above = [folder for folder in directory.parents if not folder.exists()]
            stack.callback(_remove_empty, above)
            is_new = not directory.exists()
            place = directory.parent if is_new else directory
            place.mkdir(parents=True, exist_ok=True)
            work = stack.enter_context(workspace(place, directory.name))
            new = work / NEW
            new.mkdir()
        yield new
        with writing(given):
            write_manifest(new, command, {file.name: Listed.of(file) for file in sorted(new.iterdir())})
            if not is_new:
                _replace_files(work, writes if overwrite else (), reads)
            elif not directory.exists():
                os.rename(new, directory)
            else:  # somebody made it meanwhile
                work = stack.enter_context(workspace(directory, directory.name))
                os.rename(new, work / NEW)
                _replace_files(work, writes if overwrite else (), reads)


def require_replaceable(
    directory: Path, writes: Collection[str], reads: Iterable[Path] = (), *, overwrite: bool = False
) -> Path:
    """Raise where `results_folder` would, but for failing disks.

    Returns:
        The folder that is meant.
    """
    with writing(directory):
        given, directory = directory, folder_to_write(directory)
        reads = list(reads) if directory.exists() else []
        foreign = foreign_files(directory, reads)
        if foreign and not overwrite:
            raise SequenceError(
                f"{given}: {names_told([*foreign.values()])}, expected an empty folder or unchanged results;"
                " --overwrite replaces files of the results' names only"
            )
        _refuse_lost(directory, foreign, reads, writes)
        return directory


def _refuse_lost(directory: Path, foreign: Collection[str], reads: Iterable[Path], writes: Collection[str]) -> None:
    """Raise where replacing files by name would lose what is read, or a folder."""
    names, place = sorted({*writes, MANIFEST}), directory.resolve()
    for path in reads:
        path = path.resolve()
        lost = [place / name for name in names if name in foreign] if place.is_relative_to(path) else []
        if path == place or (path.parent == place and path.name in names):
            lost = [path]
        if lost:
            raise SequenceError(f"{lost[0]}: is read, and would be written to; expected another folder for the results")
    for name in names:
        if (directory / name).is_dir():
            raise SequenceError(f"{directory / name}: is a folder, expected none of a file's name")


def _replace_files(work: Path, names: Collection[str], reads: Iterable[Path]) -> None:
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


def _remove_empty(folders: Iterable[Path]) -> None:
    with suppress(OSError):
        for folder in folders:
            folder.rmdir()
