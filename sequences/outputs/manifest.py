"""The manifest of a folder of results: its files with size and SHA-256, written last."""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import stat
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from sequences.atomic import atomic_output, clear_leftovers, is_workspace
from sequences.errors import SequenceError

MANIFEST = "manifest.json"
FORMAT, VERSION = "vapor-track results", 1
UNCHECKED = f"no {MANIFEST}: its files could not be checked"
"""What to say of a folder without a manifest."""
_LONGEST = 10_000_000  # bytes of a manifest


@dataclass(frozen=True)
class Listed:
    """A file of a manifest.

    Attributes:
        size: In bytes.
        sha256: Of its content, hexadecimal.
    """

    size: int
    sha256: str

    @classmethod
    def of(cls, file: Path) -> Listed:
        """What a file is now."""
        with file.open("rb") as content:
            return cls(file.stat().st_size, hashlib.file_digest(content, "sha256").hexdigest())

    def is_of(self, file: Path) -> bool:
        """Whether a file is what was listed."""
        found = file.lstat()
        return stat.S_ISREG(found.st_mode) and found.st_size == self.size and Listed.of(file) == self


def verify(directory: Path, names: Iterable[str]) -> None:
    """Check files that are to be read against the manifest of their folder, where it has one (else: `UNCHECKED`).

    Raises:
        SequenceError: a listed file is missing or differs, or the manifest cannot be read.
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

    Raises:
        SequenceError: there is none, or it is none of ours.
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
