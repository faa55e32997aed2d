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

    `room` is the number of calls left; negative once the disk was full.
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
    """Leave room for so many calls of this process's Python code; buffers are written when full or closed."""
    disk, opened = Disk(room), io.open

    class File(io.FileIO):
        def write(self, data: Any, /) -> Any:
            disk.use()
            return super().write(data)

    def open_file(path: Any, mode: str = "r", buffering: int = -1, *text: Any, **named: Any) -> Any:
        if not set(mode) & set("wxa+") or path == os.devnull:
            return opened(path, mode, buffering, *text, **named)
        disk.use()
        of_file = {name: named.pop(name) for name in ("closefd", "opener") if name in named}
        file = File(path, mode.replace("t", "").replace("b", ""), **of_file)
        if buffering == 0:
            return file
        buffered = io.BufferedRandom(file) if "+" in mode else io.BufferedWriter(file)
        return buffered if "b" in mode else io.TextIOWrapper(buffered, *text, **named)

    with pytest.MonkeyPatch.context() as patch:
        for name in ("mkdir", "rename", "replace"):
            patch.setattr(os, name, disk.taking(getattr(os, name)))
        for module in (io, builtins):
            patch.setattr(module, "open", open_file)
        yield disk
