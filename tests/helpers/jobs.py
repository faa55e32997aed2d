"""Jobs, some of which end their own process."""

import os
import time
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


def end_if(word: str, number: int) -> int:
    return end(number) if word == "kill" else number


def wait(number: int) -> int:
    time.sleep(0.05)
    return number
