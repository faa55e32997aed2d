"""Outputs that only the same command replaces: folders that grow, and single files."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

from sequences.atomic import CACHE, clear_leftovers, followed, is_workspace
from sequences.errors import SequenceError
from sequences.outputs.folders import folder_to_write, names_told, writing
from sequences.outputs.manifest import own_manifest, write_manifest


def claim_folder(directory: Path, command: str, *, reads: Iterable[Path] = (), overwrite: bool = False) -> None:
    """Make a folder in which a command keeps what it found, goes on after interruptions, and replaces only its own.

    It is told by a manifest that lists no files. What killed processes left is cleared away there and in all folders
    within, as the call that goes on may have nothing to write to some of them.

    Args:
        directory: Absent, empty or such a folder; made with the folders above it.
        command: What writes there, as one types it.
        reads: Files and folders that it reads: none may lie in the folder, nor the folder among what is in them.
        overwrite: Take any other folder.

    Raises:
        SequenceError: the folder holds something else, is, holds or lies among what is read, is none, or cannot be
            written to.
    """
    with writing(directory):
        given, directory = directory, folder_to_write(directory)
        reads = [path.resolve() for path in reads] if directory.exists() else []
        if inside := [path for path in reads if path.is_relative_to(directory.resolve())]:
            raise SequenceError(
                f"{inside[0]}: is read, and would be written to; expected another folder for the results"
            )
        directory.mkdir(parents=True, exist_ok=True)
        for place in {path.parent for path in directory.rglob("*") if is_workspace(path.name)}:
            clear_leftovers(place)
        if (manifest := own_manifest(directory)) is not None and manifest["files"] is None:
            return
        entries = (entry.name for entry in sorted(directory.iterdir()))
        names = [name for name in entries if not (is_workspace(name) or name == CACHE)]
        if names and not overwrite:
            raise SequenceError(
                f"{given}: {names_told(names)}, expected an empty folder or one of `{command}`; --overwrite"
                " uses it all the same"
            )
        if names and (around := [path for path in reads if directory.resolve().is_relative_to(path)]):
            raise SequenceError(
                f"{given}: {names_told(names)} and lies in {around[0]}, which is read; expected a new folder"
            )
        write_manifest(directory, command, None)


def refuse_other(
    path: Path,
    kind: str,
    is_of_kind: Callable[[Path], bool],
    *,
    reads: Iterable[Path] = (),
    overwrite: bool = False,
) -> None:
    """Refuse an output file that is anything but what an earlier call of the same command wrote.

    Args:
        path: The output.
        kind: What is written, for the message.
        is_of_kind: Whether an existing file is such a thing.
        reads: Files and folders that the command reads; of no use where the output is new.
        overwrite: Take any file but those, and but what lies in those folders.

    Raises:
        SequenceError: the output exists and is something else, is read, is part of results, or is a link to nothing.
    """
    path = followed(path)
    place = path.resolve()
    for read in (read.resolve() for read in (reads if path.exists() else ())):
        if place == read:
            raise SequenceError(f"{path}: is read, and would be written to; expected another file")
        if place.is_relative_to(read) and not (path.is_file() and is_of_kind(path)):
            raise SequenceError(f"{path}: lies in {read}, which is read, and is no {kind}; expected another file")
    if overwrite or not path.is_file():
        return
    if not is_of_kind(path):
        raise SequenceError(f"{path}: exists and is no {kind}, expected a new file or one; --overwrite replaces it")
    manifest = own_manifest(path.parent)
    if manifest is not None and path.name in (manifest["files"] or {}):
        raise SequenceError(f"{path}: belongs to the results in its folder, expected another; --overwrite replaces it")
