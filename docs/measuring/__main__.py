"""Measures what docs/measurements.md is about, and makes the page: `make measurements`.

python -m docs.measuring             what it has not measured yet; then the page
python -m docs.measuring NAME ...    these, with the code as it is; then the page
python -m docs.measuring --list      their names, how long each takes on two cores, and when it was measured
python -m docs.measuring --page      the page alone
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from docs.measuring.measurement import Measurements
from docs.measuring.page import page_of
from docs.measuring.running import ROOT, Unmeasured, measure


def main(arguments: Sequence[str], docs: Path = ROOT / "docs", folder: Path = ROOT / "build" / "measurements") -> int:
    """Run it; 1 where something could not be measured, 2 for a name that is unknown.

    Args:
        arguments: Of the command line.
        docs: See `Measurements`.
        folder: Each measurement has a folder in it.
    """
    measurements = Measurements(docs)
    entries = measurements.entries
    if list(arguments) == ["--list"]:
        for name, entry in entries.items():
            measured = (measurements.result(name) or {"date": "never"})["date"]
            print(f"{name:20} {entry.minutes:4} min  {measured:10}  {entry.title}")
        left = sum(entries[name].minutes for name in measurements.missing)
        print(f"{left / 60:.0f} hours for the {len(measurements.missing)} that are not measured yet")
        return 0
    names = [] if list(arguments) == ["--page"] else list(arguments) or measurements.missing
    unknown = [name for name in names if name not in entries]
    if unknown:
        print(f"{', '.join(unknown)}: no such measurement, expected some of {', '.join(entries)}", file=sys.stderr)
        return 2
    failures = []
    for name in names:
        try:
            measurements.keep(name, measure(entries[name], folder / name))
        except Unmeasured as error:
            failures.append(str(error))
        measurements.page.write_text(page_of(measurements), encoding="utf-8")
    measurements.page.write_text(page_of(measurements), encoding="utf-8")
    for failure in failures:
        print(failure, file=sys.stderr)
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
