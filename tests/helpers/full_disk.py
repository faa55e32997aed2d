"""A disk that is full from some call on."""

import builtins
import errno
import io
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest

ENOUGH = 10**9
"""Room for anything."""


class Disk:
    """Counts the calls that need room: files and folders that are made, renamed or written to.

    Attributes:
        room: For how many more there is room; negative once the disk was full.
    """

    def __init__(self, room: int) -> None:
        self.room = room

    def use(self) -> None:
        self.room -= 1
        if self.room < 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def taking(self, call: Callable) -> Callable:
        def taken(*arguments: Any, **options: Any) -> Any:
            self.use()
            return call(*arguments, **options)

        return taken


@contextmanager
def filling(room: int) -> Iterator[Disk]:
    """Let there be room for so many calls in this process, of Python code; what buffers hold is written when full or
    closed, as always."""
    disk, opened = Disk(room), io.open

    class File(io.FileIO):
        def write(self, data: Any, /) -> Any:
            disk.use()
            return super().write(data)

    def open_file(
        path: Any,
        mode: str = "r",
        buffering: int = -1,
        encoding: str | None = None,
        errors: str | None = None,
        newline: str | None = None,
        closefd: bool = True,
        opener: Callable | None = None,
    ) -> Any:
        if not set(mode) & set("wxa+") or path == os.devnull:
            return opened(path, mode, buffering, encoding, errors, newline, closefd, opener)
        disk.use()
        file = File(path, mode.replace("t", "").replace("b", ""), closefd, opener)
        if buffering == 0:
            return file
        buffered = io.BufferedRandom(file) if "+" in mode else io.BufferedWriter(file)
        return buffered if "b" in mode else io.TextIOWrapper(buffered, encoding, errors, newline)

    with pytest.MonkeyPatch.context() as patch:
        for name in ("mkdir", "rename", "replace"):
            patch.setattr(os, name, disk.taking(getattr(os, name)))
        for module in (io, builtins):
            patch.setattr(module, "open", open_file)
        yield disk
