"""Recordings of Rerun, as the viewer's own tool reads them."""

import subprocess
import sys
from pathlib import Path


def entities_of(path: Path) -> set[str]:
    """Entity paths in a recording."""
    command = [sys.executable, "-m", "rerun_cli", "rrd", "print", str(path)]
    text = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    return {line.split(" - ")[1].strip() for line in text.splitlines() if line.startswith("Chunk(")}
