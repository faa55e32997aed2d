"""How much memory this process has needed."""

from __future__ import annotations

import resource
import sys
from contextlib import suppress


def peak_rss_mb() -> float:
    """Peak resident memory of this process, MiB."""
    with suppress(OSError), open("/proc/self/status", encoding="ascii") as status:
        for line in status:  # what the kernel says otherwise includes that of the process that started this one
            if line.startswith("VmHWM:"):
                return float(line.split()[1]) / 2**10
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (2**20 if sys.platform == "darwin" else 2**10)
