"""Files under a URL of any file system that fsspec knows (`s3://`, `gs://`), worked on as copies on this machine.

A URL has a path in a folder of copies (`local_path`), and such a path has a URL (`url_of`). Code calls `fetched` before
it reads a file, and `published` after it has written one; with any other path neither does anything. So jobs work on
ordinary files, and need no common disk.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Any

from filtering.errors import VaporTrackError
from sequences.atomic import is_workspace, workspace

_URL = re.compile(r"(?P<protocol>[a-z][a-z0-9+.-]*)://(?P<rest>.*)")
_ROOT = "-"  # for the empty name before the first slash of file:///tmp
_VERSIONS = ("ETag", "etag", "mtime", "LastModified", "last_modified", "created")
"""Names of the version of a file in file systems."""


class StorageError(VaporTrackError):
    """Storage that cannot be used, or an invalid URL."""


def is_url(text: str) -> bool:
    """Whether this is a URL, rather than a path."""
    return _URL.fullmatch(text) is not None


def local_path(url: str) -> Path:
    """Path on this machine of the copy of a file or a folder; StorageError where the URL has other than plain names."""
    found = _URL.fullmatch(url)
    names = found["rest"].rstrip("/").split("/") if found else []
    names = [_ROOT, *names[1:]] if names[:1] == [""] and names[1:] else names
    if found is None or not all(name not in ("", ".", "..") and "::" not in name for name in names):
        raise StorageError(f"{url}: expected a URL such as s3://bucket/folder")
    return _copies().joinpath(found["protocol"], *names)


def url_of(path: Path) -> str | None:
    """The URL of a copy; None for an ordinary path."""
    copies = _copies()
    if not path.is_absolute() or not path.is_relative_to(copies):
        return None
    protocol, *names = path.relative_to(copies).parts
    return f"{protocol}://{'/'.join(['', *names[1:]] if names[:1] == [_ROOT] else names)}"


def fetched(path: Path) -> Path:
    """The same path, after the copy was updated from its URL: a file, a folder with all its content, or removed.

    Raises:
        StorageError: the storage cannot be reached, or there is no room here.
    """
    if url_of(path) is None:
        return path
    files = _files(path)
    for file, about in files.items():
        if not _is_current(file, about):
            with _asking(file) as (system, name):
                file.parent.mkdir(parents=True, exist_ok=True)
                with workspace(file.parent, file.name) as work:
                    system.get_file(name, str(work / file.name))
                    _mark(work / file.name, about)
                    os.replace(work / file.name, file)
    for file in _own_files(path):
        if file not in files:
            file.unlink(missing_ok=True)
    if not files and path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    return path


def published(path: Path, *, last: str = "") -> None:
    """Write a finished copy to its URL: a file, or those files of a folder that are not there already.

    The file with the name `last` marks a folder as complete. Any other path is left alone.

    Raises:
        StorageError: the storage cannot be reached or written to.
    """
    if url_of(path) is None:
        return
    there = _files(path)
    for file in sorted(_own_files(path), key=lambda file: (file.name == last, file)):
        if file not in there or not _is_current(file, there[file]):
            with _asking(file) as (system, name):
                system.put_file(str(file), name)
            _mark(file, _files(file)[file])


def withdrawn(path: Path) -> None:
    """Remove a file, and the file of its URL; StorageError where the storage cannot be reached or written to."""
    path.unlink(missing_ok=True)
    if url_of(path) is not None and _files(path):
        with _asking(path) as (system, name):
            system.rm_file(name)


def listed(path: Path) -> list[Path]:
    """Paths of the copies of all files under the URL of a copy; StorageError where the storage cannot be reached."""
    return sorted(_files(path))


def absent(files: Iterable[Path], folder: Path) -> set[Path]:
    """Files that are missing in a folder; storage is asked once for all."""
    if url_of(folder) is None:
        return {file for file in files if not file.exists()}
    return set(files).difference(_files(folder))


def _copies() -> Path:
    """Folder of all copies on this machine; it may be removed whenever nothing runs."""
    cache = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    return Path(os.path.abspath(os.path.expanduser(cache))) / "vapor-track"


def _own_files(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]
    inside = (file for file in path.rglob("*") if not any(map(is_workspace, file.relative_to(path).parts)))
    return [file for file in inside if file.is_file()]


def _files(path: Path) -> dict[Path, Mapping[str, Any]]:
    """Properties in storage of a file, or of all files of a folder, by the paths of their copies."""
    with _asking(path) as (system, name):
        system.invalidate_cache()  # others write there, too
        try:
            about = system.info(name)
        except FileNotFoundError:
            return {}
        if about["type"] != "directory":
            return {path: about}
        found = {key[len(name) :].strip("/"): each for key, each in system.find(name, detail=True).items()}
    for key in found:
        if not all(part not in ("", ".", "..") for part in key.split("/")):
            raise StorageError(f"{url_of(path)}: holds {key!r}, expected names without empty ones and dots")
    return {path / key: about for key, about in found.items() if not any(map(is_workspace, key.split("/")))}


def _is_current(file: Path, about: Mapping[str, Any]) -> bool:
    if not file.is_file():
        return False
    found = file.stat()
    return found.st_mtime_ns == _version_ns(about) and about["size"] in (found.st_size, None)


def _mark(file: Path, about: Mapping[str, Any]) -> None:
    # The time of change marks the version: it is the same wherever a file is copied to.
    version_ns = _version_ns(about)
    os.utime(file, ns=(version_ns, version_ns))


def _version_ns(about: Mapping[str, Any]) -> int:
    version = next((about[key] for key in _VERSIONS if about.get(key)), "")
    if isinstance(version, datetime):  # of a file asked for alone, where in a list of some it is a number
        version = version.timestamp()
    return int.from_bytes(hashlib.sha256(str(version).encode()).digest()[:4]) * 10**9  # whole seconds suit any disk


@contextmanager
def _asking(path: Path) -> Iterator[tuple[Any, str]]:
    """The file system of a copy's URL, and its name there."""
    url = url_of(path) or str(path)
    try:
        from fsspec.core import url_to_fs
    except ModuleNotFoundError as error:
        raise StorageError(f"{url}: URLs need fsspec: pip install 'vapor-track[cluster]'") from error
    try:
        yield url_to_fs(url, **({"auto_mkdir": True} if url.startswith("file:") else {}))
    except VaporTrackError:
        raise
    except Exception as error:  # every file system has errors of its own
        reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
        raise StorageError(f"{url}, with its copy at {path}: {' '.join(reason.split())}") from error
