"""A measurement is run: its commands in a folder of its own, each once, so that what is interrupted goes on."""

from __future__ import annotations

import importlib.metadata
import json
import os
import platform
import subprocess
import sys
import time
from datetime import date
from pathlib import Path
from typing import Any

from docs.measuring.measurement import Measurement
from docs.measuring.tables import table_of
from vapor.cache import code_digest

ROOT = Path(__file__).resolve().parents[2]
_DONE = "done.json"


class Unmeasured(Exception):
    """A command failed, or what it needs is not there."""


def measure(entry: Measurement, folder: Path) -> dict[str, Any]:
    """Run what has not been run, and take the figures; see `Measurements.result`.

    A command that has ended well is not run again, unless the code of the library has changed since. One that is run
    again finds what it left, and the benchmarks keep what is done of the same settings and code.

    Args:
        entry: What to measure.
        folder: Where; it stays.

    Raises:
        Unmeasured: a command fails, or what it writes lacks a figure.
    """
    folder.mkdir(parents=True, exist_ok=True)
    record, code = folder / _DONE, code_digest("sequences", "vapor")
    done = json.loads(record.read_text()) if record.exists() else {}
    if done.get("code") != code:
        done = {"code": code, "seconds": {}}
    for number, command in enumerate(map(str.strip, entry.commands)):
        if command in done["seconds"]:
            continue
        print(f"{entry.name}: {command}", flush=True)
        done["seconds"][command] = _run(entry.name, command, folder, folder / f"{number:02}.txt")
        record.write_text(json.dumps(done, indent=1))
    try:
        tables = [table_of(spec, folder) for spec in entry.table]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise Unmeasured(f"{entry.name}: no figures: {error!r}") from error
    return {
        "date": date.today().isoformat(),
        "processor": processor(),
        "commit": _commit(),
        "version": f"vapor-track {importlib.metadata.version('vapor-track')}",
        "seconds": round(sum(done["seconds"].values())),
        "commands": [command.strip() for command in entry.commands],
        "tables": tables,
    }


def _run(name: str, command: str, folder: Path, output: Path) -> float:
    recordings = Path(os.environ.get("RECORDINGS", ROOT.parent / "shared" / "data"))
    if "$RECORDINGS" in command and not recordings.is_dir():
        raise Unmeasured(f"{name}: {recordings}: no such folder, expected the recordings (RECORDINGS=FOLDER)")
    environment = os.environ | {
        "PATH": os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", os.defpath)]),
        "PYTHONPATH": str(ROOT),
        "CHECKOUT": str(ROOT),
        "RECORDINGS": str(recordings.resolve()),
    }
    begin_s = time.monotonic()
    with output.open("w") as file:
        ended = subprocess.run(["bash", "-euo", "pipefail", "-c", command], cwd=folder, env=environment, stdout=file)
    print(output.read_text(), end="", flush=True)
    if ended.returncode:
        raise Unmeasured(f"{name}: status {ended.returncode} of: {command}")
    return time.monotonic() - begin_s


def processor() -> str:
    """Name of the processor, and how many cores may be used."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        name = next(line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        name = platform.processor() or platform.machine()
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return f"{name}, {cores} cores"


def _commit() -> str:
    """Of the code, with "changed" where files of the library differ from it."""
    try:
        commit = _git("rev-parse", "--short=8", "HEAD")
        changed = _git("status", "--porcelain", "--", "filtering", "sequences", "vapor")
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return f"{commit}, changed" if changed else commit


def _git(*words: str) -> str:
    return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()
