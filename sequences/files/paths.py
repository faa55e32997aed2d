"""Names of files in a file: none leads to where nobody pointed."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from filtering.errors import quoted
from sequences.errors import SequenceError


def require_inside(folder: Path, files: Iterable[object]) -> None:
    """Check that paths which a data set names, or links in it, lead to nowhere outside of its folder.

    Args:
        folder: Where the data set lies; it may be a link itself, as someone named it.
        files: Paths; what is no path, such as an image in an archive, is passed over.

    Raises:
        SequenceError: one leads out, or is no path.
    """
    root = os.path.join(os.path.realpath(folder), "")
    real: dict[str, str] = {}
    for file in files:
        if not isinstance(file, Path):
            continue
        parent, name = os.path.split(file)
        try:
            if parent not in real:
                real[parent] = os.path.realpath(parent)
            target = os.path.join(real[parent], name)
            if name == ".." or os.path.islink(target):
                target = os.path.realpath(target)
        except (OSError, ValueError) as error:
            raise SequenceError(
                f"{folder}: {quoted(str(file))} is no path ({error}), expected one of a file"
            ) from error
        if not target.startswith(root):
            raise SequenceError(f"{folder}: {quoted(str(file))} leads out of the folder, expected files that lie in it")
