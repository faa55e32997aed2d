"""Jobs that end their own process."""

import os
from pathlib import Path
from signal import SIGKILL


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
