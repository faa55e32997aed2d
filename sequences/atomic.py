"""Output files that appear under their name only when they are complete."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sequences.errors import SequenceError


@contextmanager
def atomic_output(path: Path) -> Iterator[Path]:
    """Give a neighbouring path to write to; rename it to `path` on success, remove it on any error.

    Raises:
        SequenceError: the folder is missing, or cannot be written to.
    """
    path = Path(path)
    if not path.parent.is_dir():
        raise SequenceError(f"{path}: cannot write, expected the folder {path.parent} to exist")
    partial = path.with_name(f".{path.name}.{secrets.token_hex(4)}.partial")
    try:
        yield partial
        os.replace(partial, path)
    except OSError as error:
        raise SequenceError(f"{path}: cannot write: {error.strerror or error}") from error
    finally:
        partial.unlink(missing_ok=True)
