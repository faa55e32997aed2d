"""Folders of results: complete or absent, listed by a manifest that is written last, and only replaced by results.

A new folder is made beside its place and renamed. In an existing one files are replaced one by one, without a manifest
meanwhile. The next command that reads or writes there restores files that a killed process left half replaced.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import os
import stat
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from filtering.errors import listed
from sequences.atomic import NEW, atomic_output, clear_leftovers, followed, is_workspace, move_in, workspace
from sequences.errors import SequenceError

MANIFEST = "manifest.json"
FORMAT, VERSION = "vapor-track results", 1
UNCHECKED = f"no {MANIFEST}: its files could not be checked"
"""Notice for a folder without a manifest."""
_LONGEST = 10_000_000  # bytes of a manifest
_NAMED = 3  # files, in a message


@dataclass(frozen=True)
class Listed:
    """A file of a manifest, or a folder with all that is in it.

    Attributes:
        size: In bytes.
        sha256: Of its content, hexadecimal; of a folder, of the names and checksums in it.
    """

    size: int
    sha256: str

    @classmethod
    def of(cls, path: Path) -> Listed:
        """Size and checksum of a file or folder."""
        if path.is_dir():
            within = {entry.name: cls.of(entry) for entry in sorted(path.iterdir())}
            names = "".join(f"{listed.sha256} {name}\n" for name, listed in within.items())
            return cls(sum(listed.size for listed in within.values()), hashlib.sha256(names.encode()).hexdigest())
        with path.open("rb") as content:
            return cls(path.stat().st_size, hashlib.file_digest(content, "sha256").hexdigest())

    def is_of(self, path: Path) -> bool:
        """Whether a file or folder is as listed."""
        found = path.lstat()
        if stat.S_ISREG(found.st_mode):
            return found.st_size == self.size and Listed.of(path) == self
        return stat.S_ISDIR(found.st_mode) and Listed.of(path) == self


def verify(directory: Path, names: Iterable[str]) -> None:
    """Check files that are to be read against the manifest of their folder, where it has one (else: `UNCHECKED`).

    Raises SequenceError where a listed file is missing or differs, or the manifest cannot be read.
    """
    clear_leftovers(directory)
    if not (directory / MANIFEST).exists():
        if any(is_workspace(entry.name) for entry in directory.iterdir()):
            raise SequenceError(f"{directory}: its results are being replaced, expected no run to write to it")
        return
    files = read_manifest(directory)["files"] or {}
    for name in names:
        if name not in files:
            continue
        file = directory / name
        if not file.exists():
            raise SequenceError(f"{file}: missing, expected it as listed in {MANIFEST}")
        if not files[name].is_of(file):
            raise SequenceError(f"{file}: differs from what {MANIFEST} lists, expected it as the run wrote it")


def read_manifest(directory: Path) -> dict[str, Any]:
    """The manifest of a folder, with `Listed` by name as its `files`, None where the folder grows.

    Raises SequenceError where there is none, or it is none of ours.
    """
    path = directory / MANIFEST
    try:
        if path.stat().st_size > _LONGEST:
            raise SequenceError(f"{path}: {path.stat().st_size} bytes, expected at most {_LONGEST}")
        content = json.loads(path.read_text(encoding="utf-8"))
        if (content["format"], content["version"]) != (FORMAT, VERSION):
            raise ValueError("other format or version")
        files = content["files"]
        if files is not None:
            files = {name: Listed(int(entry["size"]), str(entry["sha256"])) for name, entry in files.items()}
            if any(Path(name).name != name or name == MANIFEST for name in files):
                raise ValueError("other names than of files")
    except (OSError, ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        raise SequenceError(f"{path}: cannot be read as a manifest of format {FORMAT!r}, version {VERSION}") from error
    return content | {"files": files}


def own_manifest(directory: Path) -> dict[str, Any] | None:
    """The manifest of a folder, None where there is none of ours."""
    try:
        return read_manifest(directory)
    except SequenceError:
        return None


def listed_results(directory: Path) -> frozenset[str]:
    """Names of the files and folders that the manifest of a folder lists; none where there is none of ours."""
    manifest = own_manifest(directory)
    return frozenset() if manifest is None else frozenset(manifest["files"] or ())


def refuse_results(directory: Path, expected: str, *, overwrite: bool = False) -> None:
    """Raise SequenceError where a folder has results that `results_folder` or `claim_folder` made.

    For a command that gives a folder of results to each of several things: beside those of one they would mix. The
    message has what is `expected` instead. `overwrite` takes any folder.
    """
    if own_manifest(directory) is not None and not overwrite:
        names = sorted(name for name in os.listdir(directory) if not is_workspace(name))
        raise SequenceError(
            f"{directory}: {short_list(names)}, expected an empty folder or {expected}; --overwrite replaces files of"
            " the results' names only"
        )


def write_manifest(directory: Path, command: str, files: Mapping[str, Listed] | None) -> None:
    """Write the manifest of a folder, with its files by name; None where the folder grows."""
    manifest = {
        "format": FORMAT,
        "version": VERSION,
        "command": command,
        "vapor-track": importlib.metadata.version("vapor-track"),
        "files": None if files is None else {name: asdict(listed) for name, listed in files.items()},
    }
    with atomic_output(directory / MANIFEST) as partial:
        partial.write_text(json.dumps(manifest, indent=2) + "\n", encoding="utf-8")


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

    Raises SequenceError where it is a file, or a link that leads to nothing.
    """
    folder = followed(directory).absolute()
    if folder.exists() and not folder.is_dir():
        raise SequenceError(f"{directory}: is a file, expected a directory to write the results to")
    clear_leftovers(folder)
    return folder


class Resolved(frozenset[Path]):
    """The places of files and folders that a command reads, links followed once for all of its outputs."""

    @classmethod
    def of(cls, paths: Iterable[Path]) -> Resolved:
        """The places of paths."""
        return paths if isinstance(paths, Resolved) else cls(path.resolve() for path in paths)


def unexpected_files(directory: Path, reads: Iterable[Path]) -> dict[str, str]:
    """Other files of a folder than the results that its manifest lists: descriptions by name.

    Files that the command reads are never results.
    """
    if not directory.is_dir():
        return {}
    manifest = own_manifest(directory)
    listed = {} if manifest is None else manifest["files"] or {}
    read = Resolved.of(reads)
    unexpected: dict[str, str] = {}
    for entry in sorted(directory.iterdir()):
        name, ours = entry.name, listed.get(entry.name)
        if is_workspace(name) or (name == MANIFEST and listed):
            continue
        if entry.resolve() in read:
            unexpected[name] = f"{name} (which is read)"
        elif ours is None:
            unexpected[name] = name
        elif not ours.is_of(entry):
            unexpected[name] = f"{name} (changed)"
    return unexpected


def short_list(names: Sequence[str]) -> str:
    """Some three names, and how many more there are."""
    return f"holds {listed((name if len(name) <= 40 else f'{name[:39]}…' for name in names), _NAMED)}"


@contextmanager
def results_folder(
    directory: Path, command: str, *, writes: Collection[str], reads: Iterable[Path] = (), overwrite: bool = False
) -> Iterator[Path]:
    """Give a hidden folder to write to; on success it takes the place of `directory`, with a manifest.

    Args:
        directory: Absent, empty or results; made with the folders above it. A link to a folder is followed.
        command: The command that writes it.
        writes: Names of all files that it may write.
        reads: Files and folders that it reads: they are never replaced, nor what lies in them but unchanged results.
        overwrite: Take any folder, and replace files of these names, and of an earlier manifest, only.

    Raises:
        SequenceError: the folder holds something else, is none, is or holds what is read, or cannot be written to.
            All but failing disks are found before anything is written.
    """
    reads = Resolved.of(reads if directory.exists() else ())
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
            else:  # it was made meanwhile
                work = stack.enter_context(workspace(directory, directory.name))
                os.rename(new, work / NEW)
                _replace_files(work, writes if overwrite else (), reads)


def require_replaceable(
    directory: Path, writes: Collection[str], reads: Iterable[Path] = (), *, overwrite: bool = False
) -> Path:
    """Raise where `results_folder` would, but for failing disks; returns the folder that is meant."""
    with writing(directory):
        given, directory = directory, folder_to_write(directory)
        reads = Resolved.of(reads if directory.exists() else ())
        unexpected = unexpected_files(directory, reads)
        if unexpected and not overwrite:
            raise SequenceError(
                f"{given}: {short_list([*unexpected.values()])}, expected an empty folder or unchanged results alone;"
                " --overwrite replaces files of the results' names only"
            )
        _refuse_lost(directory, unexpected, reads, writes)
        return directory


def _refuse_lost(directory: Path, unexpected: Collection[str], reads: Resolved, writes: Collection[str]) -> None:
    """Raise where replacing files by name would lose a file that is read, or a folder."""
    names, place = sorted({*writes, MANIFEST}), directory.resolve()
    files = [place / name for name in names]
    lost = [path for path in (place, *files) if path in reads]
    if not reads.isdisjoint(place.parents):
        lost += [file for file in files if file.name in unexpected]
    if lost:
        raise SequenceError(f"{lost[0]}: is read, and would be written to; expected another folder for the results")
    for name in names:
        if name in unexpected and (directory / name).is_dir():
            raise SequenceError(
                f"{directory / name}: is a folder, not of unchanged results; expected none of that name"
            )


def _replace_files(work: Path, names: Collection[str], reads: Resolved) -> None:
    directory = work.parent
    manifest = own_manifest(directory)
    before = {} if manifest is None else manifest["files"] or {}
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
        and (directory / name).resolve() not in reads
    ]
    first = [MANIFEST] if (directory / MANIFEST).exists() else []
    move_in(work, [*new, MANIFEST], instead_of=[*first, *gone])


def _remove_empty(folders: Iterable[Path]) -> None:
    with suppress(OSError):
        for folder in folders:
            folder.rmdir()


def claim_folder(directory: Path, command: str, *, reads: Iterable[Path] = (), overwrite: bool = False) -> None:
    """Make a folder in which a command keeps its results, goes on after interruptions, and replaces only its own.

    Its manifest lists no files. Leftovers of killed processes are removed there and in all folders within, as the call
    that goes on may have nothing to write to some of them.

    Args:
        directory: Absent, empty or such a folder; made with the folders above it.
        command: The command that writes there, as typed.
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
        names = [name for name in entries if not is_workspace(name)]
        if names and not overwrite:
            raise SequenceError(
                f"{given}: {short_list(names)}, expected an empty folder or one of `{command}`; --overwrite"
                " uses it all the same"
            )
        if names and (around := [path for path in reads if directory.resolve().is_relative_to(path)]):
            raise SequenceError(
                f"{given}: {short_list(names)} and lies in {around[0]}, which is read; expected a new folder"
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
        kind: Kind of the output, for the message.
        is_of_kind: Whether an existing file is such a thing.
        reads: Files and folders that the command reads: the output is none of these, nor replaces what lies in them.
        overwrite: Take any other file.

    Raises SequenceError where the output exists and is something else, is read, is part of results, or is a link to
    nothing.
    """
    path = followed(path)
    place, reads = path.resolve(), Resolved.of(reads if path.exists() else ())
    if place in reads:
        raise SequenceError(f"{path}: is read, and would be written to; expected another file")
    around = next((folder for folder in place.parents if folder in reads), None)
    if around is not None and not (path.is_file() and is_of_kind(path)):
        raise SequenceError(f"{path}: lies in {around}, which is read, and is no {kind}; expected another file")
    if overwrite or not path.is_file():
        return
    if not is_of_kind(path):
        raise SequenceError(f"{path}: exists and is no {kind}, expected a new file or one; --overwrite replaces it")
    manifest = own_manifest(path.parent)
    if manifest is not None and path.name in (manifest["files"] or {}):
        raise SequenceError(f"{path}: belongs to the results in its folder, expected another; --overwrite replaces it")
