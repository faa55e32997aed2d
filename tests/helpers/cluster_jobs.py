"""Jobs that take no work: they sleep, fail, or end their own process."""

import errno
import os
import time
from pathlib import Path
from signal import SIGKILL


def sleep(folder: Path, number: int, seconds: float) -> int:
    """Sleep, and leave a file with the number of the job and of its process."""
    (folder / f"{number}-{os.getpid()}").touch()
    time.sleep(seconds)
    return number


def begun(folder: Path) -> list[tuple[int, int]]:
    return sorted((int(number), int(pid)) for number, pid in (file.name.split("-") for file in folder.iterdir()))


def fill_disk(number: int) -> int:
    """The second job finds no room."""
    if number == 1:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "/scratch/result.json")
    return number


def end_once(folder: Path, number: int) -> int:
    """The second job ends its process, unless it did before."""
    marker = folder / "ended"
    if number == 1 and not marker.exists():
        marker.touch()
        os.kill(os.getpid(), SIGKILL)
    return number


def end(number: int) -> int:
    os.kill(os.getpid(), SIGKILL)
    return number
